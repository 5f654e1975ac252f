"""Damage results, runs and policies, and read them, in a child process.

A small real run of each kind is made once. A case copies one of them, damages one of its files or
plants code in it, and passes it to everything that reads such a run. Most cases then renew the
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
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import strangers

from mjgranular._util import files
from mjgranular._util.result_folder import ResultFolder
from mjgranular.cli.evaluate import find_actor
from mjgranular.cli.impact import release_to_stop
from mjgranular.cli.main import main
from mjgranular.cli.render import RenderCommand
from mjgranular.errors import GranularError
from mjgranular.experiment import Impact, Study, journal_of, run_study
from mjgranular.experiment.folder import read_impact, saved_command
from mjgranular.picture.video import Film, frames_of_impact

RUNS = Path("runs")
BALL = "<mujoco><worldbody><body><freejoint/><geom size='.1'/></body></worldbody></mujoco>"
QUICK = {
    "ppo": ("n_steps=32", "batch_size=64", "n_epochs=1"),
    "sac": ("learning_starts=32", "buffer_size=500", "train_freq=16", "gradient_steps=1"),
}
SWEEP = Study(Impact(timestep=1e-4), {"speed": [1.0, 4.0, 7.0, 10.0]})
Random = random.Random


class Bomb:
    """Makes a folder when it is unpickled."""

    def __reduce__(self) -> tuple[Callable[..., object], tuple[str]]:
        return os.mkdir, (str(Path(strangers.CANARY).resolve()),)


# Runs to damage


def make_runs() -> None:
    """Make a small real run of each kind."""
    from mjgranular.learn import change, find_settings
    from mjgranular.learn.run import begin_run
    from mjgranular.learn.train import train

    quick = ["--timestep", "1e-4", "--duration", "0.02", "--json"]
    assert main(["impact", *quick, "--out", str(RUNS / "impact")]) == 0
    model = Path("ball.xml")
    model.write_text(BALL)
    assert main(["drop", str(model), *quick, "--out", str(RUNS / "drop")]) == 0
    sweep = ["sweep", "--vary", "speed=1:10:4", "--of", "impact --timestep 1e-4"]
    assert main([*sweep, "--workers", "1", "--out", str(RUNS / "sweep")]) == 0
    rows = [*run_study(SWEEP, workers=1).rows()]
    journal = journal_of(SWEEP, RUNS / "sweep")
    for index, row in enumerate(rows[:3]):
        journal.keep(index, row)
    journal.close()
    for algorithm, some in QUICK.items():
        few = ("num_envs=2", "checkpoint_every=64", "total_steps=128", "net=[8, 8]")
        settings = change(find_settings("Pendulum-v1", algorithm=algorithm), (*few, *some))
        run = begin_run(RUNS / algorithm, "Pendulum-v1", settings, seed=0)
        with run.locked():
            train(run)
        shutil.rmtree(run.path / "tensorboard")
    (RUNS / "policy").mkdir()
    for name in ("config.json", "policy.zip", "normalizer.json", "curve.csv"):
        shutil.copyfile(RUNS / "ppo" / name, RUNS / "policy" / name)


def read_everything(folder: Path) -> None:
    """Read a run in all ways for its kind; raise the first `GranularError`."""
    from mjgranular.learn.checkpoint import load_checkpoint
    from mjgranular.learn.policies import load_policy
    from mjgranular.learn.run import open_run
    from mjgranular.learn.train import environments_of, new_model

    small = {"seconds": 0.1, "width": 32, "height": 32}

    def impact() -> None:
        done, summary, trajectory, _ = read_impact(folder)
        stop = release_to_stop(summary)
        count, _ = frames_of_impact(Film(**small), done, trajectory, stop)
        assert count < 10_000

    def sweep() -> None:
        journal = journal_of(SWEEP, folder)
        names = ("config.json", "summary.json", "sweep.csv")
        with ResultFolder(folder, names).claimed(goes_on=lambda: journal.fault() is None):
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
    learned = [act, resume, lambda: find_actor(str(folder))]
    every = [lambda: saved_command(folder), lambda: ResultFolder(folder, ("config.json",))]
    errors: list[GranularError] = []
    for reader in (*every, *readers.get(folder.name, learned)):
        try:
            reader()
        except GranularError as error:
            errors.append(error)
    if errors:
        raise errors[0]


# Damage to any file


def flipped(rng: Random, content: bytes) -> bytes:
    """Flip some bits."""
    changed = bytearray(content)
    for _ in range(rng.choice([1, 1, 8]) if content else 0):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


BYTES: dict[str, Callable[[Random, bytes], bytes]] = {
    "truncated": lambda rng, content: content[: rng.randrange(len(content) or 1)],
    "empty": lambda _rng, _content: b"",
    "bits flipped": flipped,
    "noise": lambda rng, _content: rng.randbytes(rng.choice([3, 300, 30_000])),
    "zeros": lambda _rng, content: bytes(len(content)),
    "longer": lambda rng, content: content + rng.randbytes(100),
}


def damage_bytes(rng: Random, file: Path) -> str:
    how = rng.choice(list(BYTES))
    file.write_bytes(BYTES[how](rng, file.read_bytes()))
    return how


def make_special(rng: Random, file: Path) -> str:
    kind = rng.choice(["missing", "folder", "pipe", "zero", "loop", "sparse"])
    strangers.put_special(file, kind)
    return kind


def swap(rng: Random, file: Path) -> str:
    found = [path for path in RUNS.rglob("*") if path.is_file()]
    other = rng.choice([path for path in found if path.name == file.name] * 3 + found)
    file.write_bytes(other.read_bytes())
    return f"replaced by {other}"


def name_module(_rng: Random, file: Path) -> str:
    """Have a run name a module of its folder, which must not be imported."""
    canary = str(Path(strangers.CANARY).resolve())
    for place in (file.parent, Path.cwd()):
        (place / "a_strangers_module.py").write_text(f"import os\nos.mkdir({canary!r})\n")
    content = json.loads(file.read_text())
    content["environment"] = "a_strangers_module:Evil-v0"
    file.write_text(json.dumps(content))
    return "names a module"


def plant_bomb(rng: Random, file: Path) -> str:
    """Put a pickle that executes something into a policy."""
    bomb, entries = pickle.dumps(Bomb()), entries_of(file)
    name = rng.choice([name for name in entries if name.endswith(".pth") or name == "data"])
    if name == "data":
        content = json.loads(entries[name])
        for value in content.values():
            if isinstance(value, dict) and ":serialized:" in value:
                value[":serialized:"] = base64.b64encode(bomb).decode()
        entries[name] = json.dumps(content).encode()
    else:
        entries[name] = bomb if rng.random() < 0.5 else saved({"weight": Bomb()})
    write_entries(file, entries)
    return f"a bomb in {name}"


def saved(state: Any) -> bytes:
    """Return what PyTorch would write."""
    import torch

    buffer = io.BytesIO()
    torch.save(state, buffer)
    return buffer.getvalue()


def entries_of(file: Path) -> dict[str, bytes]:
    """Read the entries of an archive."""
    with zipfile.ZipFile(file) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def write_entries(file: Path, entries: dict[str, bytes]) -> None:
    """Write an archive."""
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in entries.items():
            archive.writestr(name, content)


# A case


def damage(rng: Random, folder: Path) -> str:
    """Damage one file of a run; return how."""
    present = sorted(p for p in folder.rglob("*") if p.is_file() and p.name != files.MANIFEST)
    file = rng.choice([p for p in present if p.suffix != ".png"])
    ways: list[Callable[[Random, Path], str]] = [damage_bytes, damage_bytes, make_special, swap]
    if file.name == "config.json":
        ways += [name_module] * 2
    if file.name == "policy.zip":
        ways += [plant_bomb] * 4
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


def prepare() -> None:
    """Make the runs, check that undamaged ones are read, and watch the process."""
    warnings.simplefilter("ignore")
    sys.path.insert(0, str(Path.cwd()))  # for the stranger's module
    make_runs()
    for folder in RUNS.iterdir():
        read_everything(folder)
    strangers.guard(limited=False)  # torch reserves more addresses than memory


def read_damaged(seed: int, number: int) -> str:
    """Damage a copy of a run and read it; return what went wrong, empty if nothing did."""
    rng = Random(f"{seed} {number}")
    kind = rng.choice(sorted(RUNS.iterdir()))
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / kind.name
        shutil.copytree(kind, folder)
        how = damage(rng, folder)
        wrong = strangers.read(read_everything, folder)
    return wrong and f"seed {seed}, case {number}, {how}: {wrong}"
