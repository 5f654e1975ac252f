"""Damage saved runs in many ways, and read them: one sentence each, and nothing is executed.

`prepare` makes a small real run of each kind. A case copies one of them, damages one of its files
or plants code in it, and passes it to everything that reads such a run. Most cases then renew the
checksums that would reveal the damage, so that the readers behind them are tested too.
"""

from __future__ import annotations

import base64
import hashlib
import io
import json
import os
import pickle
import random
import shutil
import sys
import tempfile
import warnings
import zipfile
from argparse import Namespace
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from attacks import untrusted
from attacks.worker import Case, Note, Result

import mjgranular  # noqa: F401  before mujoco: it chooses the renderer without a display
from mjgranular._util import files
from mjgranular._util.result_folder import ResultFolder
from mjgranular.cli.agents import find_actor
from mjgranular.cli.impact import release_to_stop
from mjgranular.cli.main import main
from mjgranular.cli.render import RenderCommand
from mjgranular.errors import GranularError
from mjgranular.experiment import Impact, Study, journal_of, run_study
from mjgranular.experiment.folder import read_impact, saved_command
from mjgranular.learn import change, find_settings
from mjgranular.learn.checkpoint import load_checkpoint
from mjgranular.learn.policies import last_return, load_policy
from mjgranular.learn.run import begin_run, open_run
from mjgranular.learn.train import environments_of, new_model, train
from mjgranular.picture.video import Film, frames_of_run

RUNS = Path("runs")
_EVIL = "a_strangers_module"
_QUICK = {
    "ppo": ("n_steps=32", "batch_size=64", "n_epochs=1"),
    "sac": ("learning_starts=32", "buffer_size=500", "train_freq=16", "gradient_steps=1"),
}
_SWEEP = Study(Impact(timestep=1e-4), {"speed": [1.0, 4.0, 7.0, 10.0]})
Random = random.Random


class Bomb:
    """Makes a folder when it is unpickled."""

    def __reduce__(self) -> tuple[Callable[..., object], tuple[str]]:
        return os.mkdir, (str(Path(untrusted.CANARY).resolve()),)


def cases(options: Namespace, numbers: range) -> list[Case]:
    """List cases: a case depends only on its seed and number."""
    return [{"seed": options.seed, "number": number} for number in numbers]


def prepare() -> None:
    """Make the runs, unless an earlier worker has, and check that undamaged ones are read."""
    warnings.simplefilter("ignore")
    sys.path.insert(0, str(Path.cwd()))  # for the untrusted module
    if not RUNS.exists():
        make_runs(RUNS)
    for kind in RUNS.iterdir():
        read_everything(kind.name, kind)
    untrusted.guard(limited=False)  # torch reserves more addresses than memory


def attempt(case: Case, note: Note) -> Result:
    """Damage a copy of a run, and read it."""
    rng = Random(f"{case['seed']} {case['number']}")
    kinds = sorted(RUNS.iterdir())
    kind = rng.choice(kinds)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / kind.name
        shutil.copytree(kind, folder)
        how = damage(rng, folder, kinds)
        note(how)
        return untrusted.read(lambda: read_everything(kind.name, folder), how)


# Runs to damage


def make_runs(folder: Path) -> None:
    """Make a small real run of each kind."""
    quick = ["--timestep", "1e-4", "--duration", "0.02", "--json"]
    assert main(["impact", *quick, "--out", str(folder / "impact")]) == 0
    assert main(["impact", "--body", "chain:2", *quick, "--out", str(folder / "drop")]) == 0
    sweep = ["sweep", "--vary", "speed=1:10:4", "--of", "impact --timestep 1e-4"]
    assert main([*sweep, "--workers", "1", "--out", str(folder / "sweep")]) == 0
    rows = [*run_study(_SWEEP, workers=1).rows()]
    journal = journal_of(_SWEEP, folder / "sweep")
    journal.keep([*enumerate(rows[:3])])
    journal.close()
    for algorithm, some in _QUICK.items():
        few = ("num_envs=2", "checkpoint_every=64", "total_steps=128", "net=[8, 8]")
        settings = change(find_settings("Pendulum-v1", algorithm=algorithm), (*few, *some))
        run = begin_run(folder / algorithm, "Pendulum-v1", settings, seed=0)
        with run.locked():
            train(run)
        shutil.rmtree(run.path / "tensorboard")
    (folder / "policy").mkdir()
    for name in ("config.json", "policy.zip", "normalizer.json", "curve.csv"):
        shutil.copyfile(folder / "ppo" / name, folder / "policy" / name)


def read_everything(kind: str, folder: Path) -> None:
    """Read a run in all ways for its kind; raise the first `GranularError`."""
    small = {"seconds": 0.1, "width": 32, "height": 32}

    def impact() -> None:
        done, summary, trajectory = read_impact(folder)
        stop = release_to_stop(summary)
        count, _ = frames_of_run(Film(**small), done.link, trajectory, stop=stop)
        assert count < 10_000

    def sweep() -> None:
        journal = journal_of(_SWEEP, folder)
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
        "drop": [lambda: RenderCommand(run_folder=folder)._model(Film(camera="free", **small))],
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


def damage(rng: Random, folder: Path, runs: list[Path]) -> str:
    """Damage one file of a run; return how."""
    present = sorted(p for p in folder.rglob("*") if p.is_file() and p.name != files.MANIFEST)
    file = rng.choice([p for p in present if p.suffix != ".png"])
    ways: list[Callable[[Random, Path], str]] = [
        _bytes,
        _bytes,
        _special,
        lambda r, f: _swap(r, f, runs),
    ]
    if file.suffix == ".json":
        ways += [_json] * 6 + [_module] * (file.name == "config.json")
    if file.suffix == ".npz":
        ways += [_arrays] * 5
    if file.name == "policy.zip":
        ways += [_bomb_in_zip] * 4 + [_zip] * 3
    if file.suffix in (".csv", ".jsonl"):
        ways += [_text] * 2
    how = rng.choice(ways)(rng, file)
    if file.parent.name.startswith("step-") and rng.random() < 0.8:
        renew_checksums(file.parent)
        how += ", with new checksums"
    return f"{file.relative_to(folder.parent)}: {how}"


def renew_checksums(folder: Path) -> None:
    """Write the checksums of files as they are now."""
    own = folder.resolve()
    present = [p for p in folder.iterdir() if p.is_file() and p.resolve().parent == own]
    sums = {
        p.name: {"bytes": p.stat().st_size, "sha256": hashlib.sha256(p.read_bytes()).hexdigest()}
        for p in present
        if p.name != files.MANIFEST and p.stat().st_size < 2**30
    }
    (folder / files.MANIFEST).write_text(json.dumps(sums))


def flipped(rng: Random, content: bytes) -> bytes:
    """Flip some bits."""
    changed = bytearray(content)
    for _ in range(rng.choice([1, 1, 8]) if content else 0):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


_BYTES: dict[str, Callable[[Random, bytes], bytes]] = {
    "truncated": lambda rng, content: content[: rng.randrange(len(content) or 1)],
    "empty": lambda _rng, _content: b"",
    "bits flipped": flipped,
    "noise": lambda rng, _content: rng.randbytes(rng.choice([3, 300, 30_000])),
    "zeros": lambda _rng, content: bytes(len(content)),
    "longer": lambda rng, content: content + rng.randbytes(100),
}
_VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 7, 10**6, 10**30, 1.5, -0.0, 1e308, float("nan"), float("inf"),
    "", "x", "../../x", "\x1b]0;owned\x07", "\ud800", "a" * 10_000, "nan",
    [], {}, [[]], [1, 2], [10**6, 10**6], {"a": 1}, [None] * 3, [1e308] * 3, ["x"] * 3,
)  # fmt: skip
_TEXTS = {
    "nested": "[" * 100_000, "a list": "[1]", "null": "null", "a number": "7",
    "long number": "9" * 10_000, "two": "{} {}", "a byte order mark": "\ufeff{}",
}  # fmt: skip
"""Replacements for a file with a JSON object."""


def _bytes(rng: Random, file: Path) -> str:
    how = rng.choice(list(_BYTES))
    file.write_bytes(_BYTES[how](rng, file.read_bytes()))
    return how


def _special(rng: Random, file: Path) -> str:
    kind = rng.choice(["missing", "folder", "pipe", "zero", "loop", "sparse"])
    untrusted.put_special(file, kind)
    return kind


def _swap(rng: Random, file: Path, runs: list[Path]) -> str:
    found = [p for run in runs for p in run.rglob("*") if p.is_file()]
    other = rng.choice([p for p in found if p.name == file.name] * 3 + found)
    file.write_bytes(other.read_bytes())
    return f"replaced by {other.parent.name}/{other.name}"


def _text(rng: Random, file: Path) -> str:
    lines = file.read_text().splitlines(keepends=True)
    at = rng.randrange(len(lines))
    lines[at] = rng.choice(["\n", "nan,nan\n", "1,2,3\n", "x\n", "{}\n", "1e400,1,1,1,1\n", '"\n'])
    file.write_text("".join(lines))
    return f"line {at} = {lines[at]!r}"


def _json(rng: Random, file: Path) -> str:
    if rng.random() < 0.1:
        how = rng.choice(list(_TEXTS))
        file.write_text(_TEXTS[how])
        return how
    content = json.loads(file.read_text())
    holder, key = rng.choice(list(_places(content)))
    value = rng.choice(_VALUES)
    if rng.random() < 0.25:
        del holder[key]
        how = f"without {key!r}"
    else:
        holder[key] = value
        how = f"{key!r} = {str(value)[:30]!a}"
    file.write_text(json.dumps(content))
    return how


def _places(content: Any) -> Iterator[tuple[Any, Any]]:
    items = list(content.items()) if isinstance(content, dict) else list(enumerate(content))
    for key, value in items:
        yield content, key
        if isinstance(value, (dict, list)):
            yield from _places(value)


def _module(_rng: Random, file: Path) -> str:
    canary = str(Path(untrusted.CANARY).resolve())
    for place in (file.parent, Path.cwd()):
        (place / f"{_EVIL}.py").write_text(f"import os\nos.mkdir({canary!r})\n")
    content = json.loads(file.read_text())
    content["environment"] = f"{_EVIL}:Evil-v0"
    file.write_text(json.dumps(content))
    return "names a module"


# Archives

_ARRAYS: dict[str, Callable[[Random, np.ndarray], np.ndarray]] = {
    "nan": lambda _rng, array: np.full(array.shape, np.nan),
    "huge numbers": lambda rng, array: np.full(array.shape, rng.choice([1e300, -1e300])),
    "shape": lambda rng, array: array.reshape(-1)[: rng.randrange(3)],
    "pickled": lambda _rng, _array: np.array([Bomb()] * 2, dtype=object),
    "text": lambda _rng, _array: np.array(["x", "y"]),
    "complex": lambda _rng, array: array * 1j,
    "longer": lambda _rng, array: np.concatenate([np.atleast_1d(array)] * 2),
    "large": lambda _rng, _array: np.zeros((2 * 10**8, 1), dtype=np.uint8),  # compresses well
}


def _arrays(rng: Random, file: Path) -> str:
    entries = _entries(file)
    name = rng.choice(list(entries))
    how = rng.choice([*_ARRAYS, "missing", "header"])
    if how == "missing":
        del entries[name]
    elif how == "header":  # claims to be far larger than it is
        shape = f"({10 ** rng.randrange(9, 16)},)"
        head = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}}}".encode()
        entries[name] = b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head
    else:
        buffer = io.BytesIO()
        np.save(buffer, _ARRAYS[how](rng, np.asarray(np.load(io.BytesIO(entries[name])))))
        entries[name] = buffer.getvalue()
    _write_entries(file, entries)
    return f"{name}: {how}"


def _bomb_in_zip(rng: Random, file: Path) -> str:
    import torch

    bomb = pickle.dumps(Bomb())
    entries = _entries(file)
    name = rng.choice([name for name in entries if name.endswith(".pth") or name == "data"])
    if name == "data":
        content = json.loads(entries[name])
        for value in content.values():
            if isinstance(value, dict) and ":serialized:" in value:
                value[":serialized:"] = base64.b64encode(bomb).decode()
        entries[name] = json.dumps(content).encode()
    else:
        entries[name] = bomb if rng.random() < 0.5 else _saved(torch, {"weight": Bomb()})
    _write_entries(file, entries)
    return f"a bomb in {name}"


def _zip(rng: Random, file: Path) -> str:
    import torch

    entries = _entries(file)
    how = rng.choice(["missing", "empty", "noise", "large", "weights", "spaces", "counters"])
    name = rng.choice(list(entries))
    value = rng.choice([value for value in _VALUES if value != "\ud800"])
    if how == "missing":
        del entries[name]
    elif how in ("empty", "noise", "large"):
        entries[name] = {"empty": b"", "noise": rng.randbytes(200), "large": bytes(10**9)}[how]
    elif how == "weights":
        state = torch.load(io.BytesIO(entries["policy.pth"]), weights_only=True)
        name = rng.choice(list(state))
        strange = (
            torch.full_like(state[name], float("nan")),
            torch.zeros(()).expand(10**12),
            torch.zeros(2, dtype=torch.int64),
            torch.zeros(3),
            torch.zeros(3).to_sparse(),
            "x",
        )
        state[name] = rng.choice(strange)
        entries["policy.pth"] = _saved(torch, state)
    else:
        content = json.loads(entries["data"])
        changed = content
        if how == "spaces":
            entries.pop("spaces.json", None)
            changed = content[rng.choice(["observation_space", "action_space"])]
        changed[rng.choice(list(changed))] = value
        entries["data"] = json.dumps(content).encode()
    _write_entries(file, entries)
    return f"{how} ({name})"


def _saved(torch: Any, state: Any) -> bytes:
    buffer = io.BytesIO()
    torch.save(state, buffer)
    return buffer.getvalue()


def _entries(file: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(file) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def _write_entries(file: Path, entries: dict[str, bytes]) -> None:
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in entries.items():
            archive.writestr(name, content)
