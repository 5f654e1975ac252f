"""Damages saved runs in many ways, and reads them: one sentence each, and nothing is executed.

    python scripts/attacks/files.py --seed 1 --count 2000

Small real runs of each kind are made first. Each round copies one of them, damages a file of it, or
plants something in it that would execute code, and gives it to all that reads such a run. That must
succeed or raise a `GranularError` with one sentence, in 5 s and with 500 MB more memory at most; no
bomb may go off. Sums that would find the damage are made anew in most rounds, so that what lies
behind them is tried, too.
"""

from __future__ import annotations

import argparse
import base64
import hashlib
import io
import json
import os
import pickle
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
import warnings
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

import mjgranular  # noqa: F401  before mujoco: it chooses how to draw without a screen
from mjgranular import files
from mjgranular.cli.agents import find_actor
from mjgranular.cli.impact import release_to_stop
from mjgranular.cli.main import main
from mjgranular.cli.render import RenderCommand
from mjgranular.errors import GranularError
from mjgranular.experiment import Impact, Sweep
from mjgranular.experiment.folder import ResultFolder, read_impact, saved_command
from mjgranular.learn import change, find_settings
from mjgranular.learn import train as _training  # noqa: F401  its imports are not timed below
from mjgranular.learn.checkpoint import load_checkpoint
from mjgranular.learn.policies import last_return, load_policy
from mjgranular.learn.run import begin_run, open_run
from mjgranular.learn.train import environments_of, new_model, train
from mjgranular.picture.video import Film, frames_of_run

SECONDS = 5.0
MEGABYTES = 500
_EVIL = "a_strangers_module"
_QUICK = {
    "ppo": ("n_steps=32", "batch_size=64", "n_epochs=1"),
    "sac": ("learning_starts=32", "buffer_size=500", "train_freq=16", "gradient_steps=1"),
}
_SWEEP = Sweep(points=4, impact=Impact(timestep=1e-4))


class Bomb:
    """Goes off when it is unpickled."""

    def __init__(self, marker: Path) -> None:
        self._marker = marker

    def __reduce__(self) -> tuple[Callable[..., object], tuple[str]]:
        return os.mkdir, (str(self._marker),)


# Runs to be damaged


def make_runs(folder: Path) -> list[Path]:
    """A small real run of each kind; returns their folders."""
    quick = ["--timestep", "1e-4", "--duration", "0.02", "--json"]
    with _silent():
        assert main(["impact", *quick, "--out", str(folder / "impact")]) == 0
        assert main(["impact", "--body", "chain:2", *quick, "--out", str(folder / "drop")]) == 0
        assert main(["sweep", "--points", "4", *quick[:2], "--workers", "1", "--json",
                     "--out", str(folder / "sweep")]) == 0  # fmt: skip
    rows = json.loads((folder / "sweep" / "summary.json").read_text())
    journal = _SWEEP.journal(folder / "sweep")
    journal.keep([*enumerate(rows[:3])])
    journal.close()
    for algorithm, some in _QUICK.items():
        few = ("num_envs=2", "checkpoint_every=64", "total_steps=128", "net=[8, 8]")
        settings = change(find_settings("Pendulum-v1", algorithm=algorithm), (*few, *some))
        run = begin_run(folder / algorithm, "Pendulum-v1", settings, seed=0)
        with run.locked():
            train(run)
        shutil.rmtree(run.path / "tensorboard")
    copy = folder / "policy"
    copy.mkdir()
    for name in ("config.json", "policy.zip", "normalizer.json", "curve.csv"):
        shutil.copyfile(folder / "ppo" / name, copy / name)
    return sorted(folder.iterdir())


# Readers


def read_everything(kind: str, folder: Path) -> None:
    """Reads a run in all ways that there are for its kind; any may raise `GranularError`."""
    film = Film(seconds=0.1, width=32, height=32)
    command = RenderCommand(run_folder=folder)

    def impact() -> None:
        done, summary, trajectory = read_impact(folder)
        stop = release_to_stop(summary)
        count, _ = frames_of_run(film, done.link, trajectory, stop=stop)
        assert count < 10_000

    def drop() -> None:
        command._model(Film(camera="free", seconds=0.1, width=32, height=32))

    def sweep() -> None:
        journal = _SWEEP.journal(folder)
        names = ("config.json", "summary.json", "sweep.csv")
        with ResultFolder(folder, names).claimed(goes_on=journal.goes_on):
            journal.begin()
            list(journal.results())
            journal.close()

    def act() -> None:
        policy = load_policy(folder)
        action = policy.act(np.zeros((2, *policy.model.observation_space.shape)), np.zeros(2))
        assert np.isfinite(action).all()

    def resume() -> None:
        run = open_run(folder)
        run.check_environment()
        env = environments_of(run)
        try:
            newest = run.newest_checkpoint()
            if newest is not None:
                load_checkpoint(newest, run, env, lambda: new_model(run, env))
        finally:
            env.close()

    readers: dict[str, list[Callable[[], object]]] = {
        "impact": [impact],
        "drop": [drop],
        "sweep": [sweep],
    }
    learned = [act, resume, lambda: find_actor(str(folder)), lambda: last_return(open_run(folder))]
    every = [lambda: saved_command(folder), lambda: ResultFolder(folder, ("config.json",))]
    first: GranularError | None = None
    for reader in (*every, *readers.get(kind, learned)):
        try:
            reader()
        except GranularError as error:
            first = first or error
    if first is not None:
        raise first


# Damage


def damage(rng: random.Random, folder: Path, others: list[Path], marker: Path) -> str:
    """Damages one file of a run; says how."""
    present = sorted(p for p in folder.rglob("*") if p.is_file() and p.name != files.MANIFEST)
    file = rng.choice([p for p in present if p.suffix not in (".png",)])
    ways: list[Callable[..., str]] = [_bytes, _bytes, _kind_of_file, _swap]
    if file.suffix == ".json":
        ways += [_json] * 6 + [_module] * (file.name == "config.json")
    if file.suffix == ".npz":
        ways += [_arrays] * 5
    if file.name == "policy.zip":
        ways += [_bombs_in_zip] * 4 + [_zip] * 3
    if file.suffix in (".csv", ".jsonl"):
        ways += [_text] * 2
    way = rng.choice(ways)
    said = way(rng, file, others, marker)
    if file.parent.name.startswith("step-") and rng.random() < 0.8:
        _sum_anew(file.parent)
        said += ", with sums made anew"
    return f"{file.relative_to(folder.parent)}: {said}"


def _bytes(rng: random.Random, file: Path, _others: object, _marker: Path) -> str:
    content = bytearray(file.read_bytes())
    how = rng.choice(["truncated", "empty", "bits flipped", "noise", "zeros", "longer"])
    if how == "truncated":
        content = content[: rng.randrange(len(content) or 1)]
    elif how == "empty":
        content = bytearray()
    elif how == "bits flipped":
        for _ in range(rng.choice([1, 1, 8])):
            if content:
                content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    elif how == "noise":
        content = bytearray(rng.randbytes(rng.choice([3, 300, 30_000])))
    elif how == "zeros":
        content = bytearray(len(content))
    else:
        content += rng.randbytes(100)
    file.write_bytes(content)
    return how


def _kind_of_file(rng: random.Random, file: Path, _others: object, _marker: Path) -> str:
    file.unlink()
    how = rng.choice(["missing", "a folder", "a pipe", "endless", "a link to itself", "huge"])
    if how == "a folder":
        file.mkdir()
    elif how == "a pipe":
        os.mkfifo(file)
    elif how == "endless":
        file.symlink_to("/dev/zero")
    elif how == "a link to itself":
        file.symlink_to(file)
    elif how == "huge":
        with file.open("wb") as stream:
            stream.truncate(50 * 2**30)  # takes no room on the disk
    return how


def _swap(rng: random.Random, file: Path, others: list[Path], _marker: Path) -> str:
    found = [p for other in others for p in other.rglob("*") if p.is_file()]
    other = rng.choice([p for p in found if p.name == file.name] * 3 + found)
    file.write_bytes(other.read_bytes())
    return f"replaced by {other.parent.name}/{other.name}"


_VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 7, 10**6, 10**30, 1.5, -0.0, 1e308, float("nan"), float("inf"),
    "", "x", "../../x", "\x1b]0;owned\x07", "\ud800", "a" * 10_000, "nan",
    [], {}, [[]], [1, 2], [10**6, 10**6], {"a": 1}, [None] * 3, [1e308] * 3, ["x"] * 3,
)  # fmt: skip


def _json(rng: random.Random, file: Path, _others: object, _marker: Path) -> str:
    content = json.loads(file.read_text())
    if rng.random() < 0.1:
        how, text = rng.choice([
            ("nested", "[" * 100_000), ("a list", "[1]"), ("null", "null"), ("a number", "7"),
            ("long number", "9" * 10_000), ("two", "{} {}"), ("a mark", "\ufeff{}"),
        ])  # fmt: skip
        file.write_text(text)
        return how
    places = list(_places(content))
    holder, key = rng.choice(places)
    value = rng.choice(_VALUES)
    if rng.random() < 0.25:
        del holder[key]
        said = f"without {key!r}"
    else:
        holder[key] = value
        said = f"{key!r} = {str(value)[:30]!a}"
    file.write_text(json.dumps(content))
    return said


def _places(content: Any) -> Iterator[tuple[Any, Any]]:
    items = list(content.items()) if isinstance(content, dict) else list(enumerate(content))
    for key, value in items:
        yield content, key
        if isinstance(value, (dict, list)):
            yield from _places(value)


def _module(_rng: random.Random, file: Path, _others: object, marker: Path) -> str:
    for place in (file.parent, marker.parent):
        code = f"import os\nos.mkdir({str(marker)!r})\n"
        (place / f"{_EVIL}.py").write_text(code)
    content = json.loads(file.read_text())
    content["environment"] = f"{_EVIL}:Evil-v0"
    file.write_text(json.dumps(content))
    return "names a module"


def _arrays(rng: random.Random, file: Path, _others: object, marker: Path) -> str:
    with np.load(file) as archive:
        arrays: dict[str, Any] = {name: archive[name] for name in archive.files}
    name = rng.choice(list(arrays))
    array = arrays[name]
    how = rng.choice(["missing", "nan", "shape", "pickled", "text", "complex", "longer", "bomb",
                      "header", "huge numbers"])  # fmt: skip
    if how == "missing":
        del arrays[name]
    elif how == "nan":
        arrays[name] = np.full(np.shape(array), np.nan)
    elif how == "huge numbers":
        arrays[name] = np.full(np.shape(array), rng.choice([1e300, -1e300]))
    elif how == "shape":
        arrays[name] = np.asarray(array).reshape(-1)[: rng.randrange(3)]
    elif how == "pickled":
        arrays[name] = np.array([Bomb(marker)] * 2, dtype=object)
    elif how == "text":
        arrays[name] = np.array(["x", "y"])
    elif how == "complex":
        arrays[name] = np.asarray(array) * 1j
    elif how == "longer":
        arrays[name] = np.concatenate([np.atleast_1d(array)] * 2)
    elif how == "bomb":
        arrays[name] = np.zeros(2 * 10**8, dtype=np.uint8).reshape(-1, 1)  # packs to nothing
    if how == "header":  # says that it is far larger than it is
        head = (
            f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({10 ** rng.randrange(9, 16)},)}}"
        )
        raw = b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head.encode()
        with zipfile.ZipFile(file, "w") as archive:
            for other in arrays:
                buffer = io.BytesIO()
                np.save(buffer, arrays[other])
                archive.writestr(f"{other}.npy", raw if other == name else buffer.getvalue())
        return f"{name}: {how}"
    with file.open("wb") as stream:
        np.savez_compressed(stream, **arrays)
    return f"{name}: {how}"


def _bombs_in_zip(rng: random.Random, file: Path, _others: object, marker: Path) -> str:
    import torch

    bomb = pickle.dumps(Bomb(marker))
    entries = _entries(file)
    name = rng.choice([name for name in entries if name.endswith(".pth") or name == "data"])
    if name == "data":
        content = json.loads(entries[name])
        for value in content.values():
            if isinstance(value, dict) and ":serialized:" in value:
                value[":serialized:"] = base64.b64encode(bomb).decode()
        entries[name] = json.dumps(content).encode()
    elif rng.random() < 0.5:
        entries[name] = bomb
    else:
        buffer = io.BytesIO()
        torch.save({"weight": Bomb(marker)}, buffer)
        entries[name] = buffer.getvalue()
    _write_entries(file, entries)
    replay = file.with_name("replay.npz")
    if replay.exists():
        replay.unlink()
        replay.with_suffix(".pkl").write_bytes(bomb)
    return f"a bomb in {name}"


def _zip(rng: random.Random, file: Path, _others: object, _marker: Path) -> str:
    import torch

    entries = _entries(file)
    how = rng.choice(["missing", "empty", "noise", "large", "weights", "spaces", "counters"])
    name = rng.choice(list(entries))
    if how == "missing":
        del entries[name]
    elif how in ("empty", "noise"):
        entries[name] = b"" if how == "empty" else rng.randbytes(200)
    elif how == "large":
        entries[name] = bytes(10**9)
    elif how == "weights":
        state = torch.load(io.BytesIO(entries["policy.pth"]), weights_only=True)
        name = rng.choice(list(state))
        state[name] = rng.choice(
            [
                torch.full_like(state[name], float("nan")),
                torch.zeros(3),
                torch.zeros(()).expand(10**12),
                torch.zeros(2, dtype=torch.int64),
                torch.zeros(3).to_sparse(),
                "x",
            ]
        )
        buffer = io.BytesIO()
        torch.save(state, buffer)
        entries["policy.pth"] = buffer.getvalue()
    elif how == "spaces":
        entries.pop("spaces.json", None)
        content = json.loads(entries["data"])
        space = content[rng.choice(["observation_space", "action_space"])]
        space[rng.choice(list(space))] = rng.choice([v for v in _VALUES if v != "\ud800"])
        entries["data"] = json.dumps(content).encode()
    else:
        content = json.loads(entries["data"])
        content[rng.choice(list(content))] = rng.choice([v for v in _VALUES if v != "\ud800"])
        entries["data"] = json.dumps(content).encode()
    _write_entries(file, entries)
    return f"{how} ({name})"


def _text(rng: random.Random, file: Path, _others: object, _marker: Path) -> str:
    lines = file.read_text().splitlines(keepends=True)
    at = rng.randrange(len(lines))
    lines[at] = rng.choice(["\n", "nan,nan\n", "1,2,3\n", "x\n", "{}\n", "1e400,1,1,1,1\n", '"\n'])
    file.write_text("".join(lines))
    return f"line {at} = {lines[at]!r}"


def _entries(file: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(file) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def _write_entries(file: Path, entries: dict[str, bytes]) -> None:
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in entries.items():
            archive.writestr(name, content)


def _sum_anew(folder: Path) -> None:
    there = [p for p in folder.iterdir() if p.is_file() and p.name != files.MANIFEST]
    there = [
        p for p in there if p.stat().st_size < 2**30 and p.resolve().parent == folder.resolve()
    ]
    sums = {
        p.name: {"bytes": p.stat().st_size, "sha256": hashlib.sha256(p.read_bytes()).hexdigest()}
        for p in there
    }
    (folder / files.MANIFEST).write_text(json.dumps(sums))


# The attack


def run(seed: int, count: int) -> list[str]:
    """Damages and reads `count` runs.

    Returns:
        What went wrong, a line each; empty if nothing did.
    """
    failures: list[str] = []
    said: set[str] = set()
    with tempfile.TemporaryDirectory() as scratch:
        place = Path(scratch)
        marker = place / "executed"
        (place / "runs").mkdir()
        kinds = make_runs(place / "runs")
        sys.path.insert(0, str(place))
        try:
            for kind in kinds:
                _round(kind.name, kind, "undamaged", marker, said)
            for number in range(count):
                rng = random.Random(f"{seed} {number}")
                kind = rng.choice(kinds)
                folder = place / f"{kind.name}-{number}"
                shutil.copytree(kind, folder)
                how = damage(rng, folder, kinds, marker)
                wrong = _round(kind.name, folder, how, marker, said)
                if wrong is not None:
                    failures.append(f"seed {seed} round {number}: {wrong}")
                shutil.rmtree(folder)
        finally:
            sys.path.remove(str(place))
            sys.modules.pop(_EVIL, None)
    run.said = said  # type: ignore[attr-defined]  # for a look at the sentences
    return failures


def _round(kind: str, folder: Path, how: str, marker: Path, said: set[str]) -> str | None:
    """Reads one run; what is wrong with the way it was read."""
    before, began = _memory(), time.monotonic()
    try:
        with _silent(), _at_most(4 * SECONDS):
            read_everything(kind, folder)
    except GranularError as error:
        sentence = str(error)
        said.add(sentence.replace(str(folder), "RUN"))
        if "\n" in sentence or len(sentence) > 1500 or not sentence.isprintable():
            return f"{how}: {sentence[:300]!r} is not one sentence"
        if how == "undamaged":
            raise
    except Exception as error:
        return f"{how}: {type(error).__name__}: {str(error)[:300]}"
    if marker.exists():
        marker.rmdir()
        return f"{how}: code was executed"
    seconds, grown = time.monotonic() - began, _memory() - before
    if seconds > SECONDS or grown > MEGABYTES:
        return f"{how}: took {seconds:.1f} s and {grown:.0f} MB"
    return None


def _memory() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024  # [MB]


@contextmanager
def _silent() -> Iterator[None]:
    with open(os.devnull, "w") as nowhere, warnings.catch_warnings():  # noqa: PTH123
        warnings.simplefilter("ignore")
        before = sys.stdout
        sys.stdout = nowhere
        try:
            yield
        finally:
            sys.stdout = before


@contextmanager
def _at_most(seconds: float) -> Iterator[None]:
    """Ends what waits for ever, with a `TimeoutError`."""

    def ring(_number: int, _frame: object) -> None:
        raise TimeoutError(f"not done after {seconds:g} s")

    previous = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, previous)


def _main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--sentences", action="store_true", help="print what was said")
    options = parser.parse_args()
    failures = run(options.seed, options.count)
    if options.sentences:
        with suppress(BrokenPipeError):
            print(*sorted(run.said), sep="\n")  # type: ignore[attr-defined]
    print(*failures, sep="\n")
    print(f"{len(failures)} of {options.count} rounds failed")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(_main())
