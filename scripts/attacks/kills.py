"""Kills commands at random moments, and has them go on: nothing may be lost, nothing mixed.

    python scripts/attacks/kills.py --seed 1 --count 100
    python scripts/attacks/kills.py --kinds train sweep --count 20

Each of `impact`, `sweep`, `train` and `compare` is started in a folder, killed up to four times and
begun again each time, then left to end. Half of the kills come after a random time, half at a
random one of its operations on files, where a crash hurts most; one in four is a SIGTERM. After
each kill what is in the folder must be whole: the old result or the new one, every row and
checkpoint that was there before. In the end the result must be that of an undisturbed command, to
the last bit, and no process and no file of a killed one may be left.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import mjgranular  # noqa: F401  before mujoco: it chooses how to draw without a screen
from mjgranular.cli.main import main
from mjgranular.errors import GranularError, OutputError
from mjgranular.experiment.folder import CONFIG, read_impact
from mjgranular.extras import need
from mjgranular.learn import train as _training  # noqa: F401  imported once, for all children
from mjgranular.learn.policies import load_policy
from mjgranular.learn.run import open_run
from mjgranular.pool import UNFINISHED

_OPERATIONS = ("replace", "rename", "fsync", "unlink", "mkdir", "rmdir", "open")
_MOST_KILLS = 4
_WAIT = 120.0  # [s]


@dataclass
class Case:
    """A command that is killed.

    Attributes:
        kind: its name.
        command: its arguments for a folder; whether to go on is seen from what is there.
        look: what is whole in the folder after a kill; raises or asserts if something is not.
        result: what an undisturbed command came to, for comparison.
        same: whether results must be the same after a SIGTERM, too.
        prepare: fills the folder before the first start.
    """

    kind: str
    command: Callable[[Path], list[str]]
    look: Callable[[Path], float]
    result: Callable[[Path], Any]
    same: bool = True
    prepare: Callable[[Path], None] | None = None
    seconds: float = 0.0
    operations: int = 0
    expected: Any = field(default=None)


# Commands


def impact(speed: str = "4") -> Case:
    """A drop, over the result of another."""
    quick = ["impact", "--timestep", "1e-4", "--duration", "0.05", "--json", "--overwrite"]

    def command(folder: Path) -> list[str]:
        return [*quick, "--speed", speed, "--out", str(folder)]

    def result(folder: Path) -> tuple[Any, ...]:
        done, summary, trajectory = read_impact(folder)
        assert (folder / "motion.png").stat().st_size > 1000
        return done, summary, trajectory.table().tobytes()

    known: dict[float, Any] = {}

    def look(folder: Path) -> float:
        done, summary, trajectory = read_impact(folder)  # the old one at least
        assert done.speed == summary["speed"]
        whole = summary, trajectory.table().tobytes()
        assert known.setdefault(done.speed, whole) == whole, "mixed"
        return 0.0

    def prepare(folder: Path) -> None:
        _call([*quick, "--speed", "2", "--out", str(folder)])

    return Case("impact", command, look, result, prepare=prepare)


def sweep(workers: int) -> Case:
    """A sweep, in this process or in others."""
    quick = ["sweep", "--points", "12", "--timestep", "2e-5", "--duration", "0.05", "--json"]

    def command(folder: Path) -> list[str]:
        return [*quick, "--workers", str(workers), "--out", str(folder)]

    def result(folder: Path) -> str:
        assert not (folder / UNFINISHED).exists()
        assert json.loads((folder / CONFIG).read_text())["config"]["interrupted"] is False
        return (folder / "summary.json").read_text()

    def look(folder: Path) -> float:
        with suppress(FileNotFoundError):
            lines = (folder / UNFINISHED).read_text().split("\n")[1:-1]
            for line in lines:
                row = json.loads(line)
                assert row["row"] == json.loads(case.expected)[row["index"]], "another row"
            return len(lines)
        # Of a finished one.
        with suppress(FileNotFoundError):
            return len(json.loads((folder / "summary.json").read_text()))
        return 0.0

    case = Case(f"sweep on {workers}", command, look, result)
    return case


_TRAIN = {
    "ppo": ("n_steps=32", "batch_size=64", "n_epochs=1"),
    "sac": ("learning_starts=32", "buffer_size=1000", "train_freq=16", "gradient_steps=1"),
    "td3": ("learning_starts=32", "buffer_size=1000", "train_freq=16", "gradient_steps=1"),
}


def train(algorithm: str) -> Case:
    """A training."""
    few = ["num_envs=2", "checkpoint_every=64", "total_steps=320", "net=[8,8]"]

    def command(folder: Path) -> list[str]:
        if (folder / CONFIG).exists():
            return ["train", "--resume", str(folder), "--json"]
        begin = ["train", "Pendulum-v1", "--algorithm", algorithm, "--json", "--out", str(folder)]
        return [*begin, "--set", *few, *_TRAIN[algorithm]]

    def result(folder: Path) -> tuple[bytes, str]:
        run = open_run(folder)
        newest = run.newest_checkpoint()
        assert newest is not None
        for name in ("policy.zip", "normalizer.json", "curve.csv"):
            assert (folder / name).read_bytes() == (newest / name).read_bytes(), name
        state = load_policy(folder).model.state_dict()
        numbers = np.concatenate([value.numpy().ravel() for value in state.values()])
        return numbers.tobytes(), (folder / "normalizer.json").read_text()

    return Case(f"train {algorithm}", command, _steps, result, same=False)


def compare() -> Case:
    """Three trainings on different grounds, and their evaluation."""
    small = ["num_envs=2", "n_steps=16", "batch_size=32", "n_epochs=1", "checkpoint_every=32"]
    few = ["--policies", "1", "--seeds", "2", "--total-steps", "64", "--json"]

    def command(folder: Path) -> list[str]:
        return ["compare", "Hopper", *few, "--out", str(folder), "--set", *small, "net=[8,8]"]

    def look(folder: Path) -> float:
        return sum(_steps(run) for run in folder.glob("*-0"))

    def result(folder: Path) -> str:
        assert (folder / "compare.png").stat().st_size > 1000
        return (folder / "summary.json").read_text()

    return Case("compare", command, look, result, same=False)


def _steps(folder: Path) -> float:
    """Steps that the newest checkpoint of a run has behind it, 0 without a run."""
    if not (folder / CONFIG).exists():
        return 0.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a damaged checkpoint
        run = open_run(folder)
        if run.checkpoints():
            load_policy(folder)
        return run.steps()


CASES: dict[str, Callable[[], list[Case]]] = {
    "impact": lambda: [impact()],
    "sweep": lambda: [sweep(1), sweep(2)],
    "train": lambda: [train(name) for name in _TRAIN],
    "compare": lambda: [compare()],
}


# Children


def _child(arguments: list[str], log: Path, *, crash_at: int = 0, tally: Path | None = None) -> int:
    """Starts a command in a fork of this process, and gives its id.

    Args:
        arguments: of the command.
        log: for what it prints.
        crash_at: number of the operation on files at which it kills itself; 0 for never.
        tally: where it notes the number of its operations.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of forks beside threads: none of ours holds a lock
        pid = os.fork()
    if pid:
        return pid
    status = 70
    try:
        os.setsid()
        signal.signal(signal.SIGINT, signal.default_int_handler)
        descriptor = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(descriptor, 1)
        os.dup2(descriptor, 2)
        sys.stdout = os.fdopen(1, "w", closefd=False)
        sys.stderr = os.fdopen(2, "w", closefd=False)
        count = _count_operations(crash_at)
        status = main(arguments)
        if tally is not None:
            tally.write_text(str(count[0]))
    except SystemExit as stop:
        status = stop.code if isinstance(stop.code, int) else 1
    except BaseException as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
    finally:
        with suppress(BaseException):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(status)


def _count_operations(crash_at: int) -> list[int]:
    """Has operations on files counted from now on; at one of them the process kills itself."""
    count = [0]

    def counted(name: str) -> Callable[..., Any]:
        original = getattr(os, name)

        def operation(*args: Any, **kwargs: Any) -> Any:
            count[0] += 1
            if count[0] == crash_at:
                os.kill(os.getpid(), signal.SIGKILL)
            return original(*args, **kwargs)

        return operation

    for name in _OPERATIONS:
        setattr(os, name, counted(name))
    return count


def _wait(pid: int, seconds: float) -> int | None:
    """The status of a child that ends within that time, else None."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.005)
    return None


def _call(arguments: list[str]) -> None:
    """Runs a command to its end."""
    with tempfile.TemporaryDirectory() as scratch:
        log = Path(scratch) / "log"
        status = _wait(_child(arguments, log), _WAIT)
        assert status == 0, (status, log.read_text()[-500:])


def _left_behind(session: int) -> list[str]:
    """Processes of a session that are still there, by their command lines."""
    found = []
    for entry in Path("/proc").iterdir():
        with suppress(OSError, ValueError, IndexError):
            fields = (entry / "stat").read_text().rpartition(")")[2].split()
            if entry.name.isdigit() and int(fields[3]) == session and fields[0] != "Z":
                found.append((entry / "cmdline").read_text().replace("\0", " ")[:100])
    return found


# The attack


def attack(case: Case, rng: random.Random, kills: int, place: Path) -> list[str]:
    """Runs one command with so many kills; returns what went wrong."""
    folder, log = place / "out", place / "log"
    shutil.rmtree(folder, ignore_errors=True)
    if case.prepare is not None:
        case.prepare(folder)
    failures: list[str] = []
    reached, terminated = 0.0, False
    for _ in range(kills):
        by_term = rng.random() < 0.25
        at_operation = not by_term and rng.random() < 0.6
        crash_at = rng.randrange(1, case.operations + 1) if at_operation else 0
        how = f"operation {crash_at}" if at_operation else ("SIGTERM" if by_term else "SIGKILL")
        pid = _child(case.command(folder), log, crash_at=crash_at)
        status = _wait(pid, _WAIT if at_operation else rng.uniform(0.0, 1.1) * case.seconds)
        if status is None:
            terminated |= by_term
            os.kill(pid, signal.SIGTERM if by_term else signal.SIGKILL)
            status = _wait(pid, 30.0)
        if status is None:
            os.kill(pid, signal.SIGKILL)
            _wait(pid, 30.0)
            failures.append(f"{how}: did not end within 30 s of a SIGTERM")
        elif _is_done(case, status, log):
            break
        elif status not in (0, -9, -15, 143) or (status == -9 and by_term):
            failures.append(f"{how}: ended with {status}: {log.read_text()[-300:]}")
        try:
            now = case.look(folder)
        except (GranularError, AssertionError, ValueError, Warning) as error:
            failures.append(f"after {how}: {type(error).__name__} {str(error)[:300]}")
        else:
            if now < reached:
                failures.append(f"after {how}: {now:g} are there of {reached:g}")
            reached = max(now, reached)
        until = time.monotonic() + 10
        while (left := _left_behind(pid)) and time.monotonic() < until:
            time.sleep(0.05)
        if left:
            failures.append(f"after {how}: processes are left: {left}")
    failures += _end(case, folder, log, terminated)
    return failures


def _is_done(case: Case, status: int | None, log: Path) -> bool:
    """Tells whether a sweep came to its end before, so that the same command is refused."""
    return (
        case.kind.startswith("sweep")
        and status == 2
        and "holds a result already (config.json" in log.read_text()
    )


def _end(case: Case, folder: Path, log: Path, terminated: bool) -> list[str]:
    """Lets the command end, and compares what it came to."""
    status = _wait(_child(case.command(folder), log), _WAIT)
    if status != 0 and not _is_done(case, status, log):
        return [f"in the end: {status}: {log.read_text()[-300:]}"]
    try:
        result = case.result(folder)
    except (GranularError, AssertionError, OSError) as error:
        return [f"in the end: {type(error).__name__} {error}"]
    failures = []
    if (case.same or not terminated) and result != case.expected:
        failures.append("the result is another one than that of an undisturbed command")
    # A lock that nobody holds is left by a process that was killed after its work was done.
    hidden = [str(p.relative_to(folder)) for p in folder.rglob(".*") if p.name != ".lock"]
    if hidden:
        failures.append(f"left behind: {hidden}")
    return failures


def measure(case: Case, place: Path) -> None:
    """Runs the command undisturbed: how long it takes, how many operations, and its result."""
    folder, tally = place / "undisturbed", place / "tally"
    for _ in range(2):  # the first one may compile
        shutil.rmtree(folder, ignore_errors=True)
        began = time.monotonic()
        pid = _child(case.command(folder), place / "log", tally=tally)
        status = _wait(pid, 10 * _WAIT)
        case.seconds = time.monotonic() - began
        if status != 0:
            raise OutputError(f"{case.kind} ended with {status}: {(place / 'log').read_text()}")
    case.operations = int(tally.read_text())
    case.expected = case.result(folder)
    shutil.rmtree(folder)


def run(seed: int, count: int, kinds: tuple[str, ...] = tuple(CASES)) -> list[str]:
    """Kills each kind of command `count` times.

    Returns:
        What went wrong, a line each; empty if nothing did.
    """
    need("matplotlib.figure", extra="figures", purpose="Drawing")
    failures: list[str] = []
    for kind in kinds:
        began, done = time.monotonic(), 0
        with tempfile.TemporaryDirectory() as scratch:
            place = Path(scratch)
            cases = CASES[kind]()
            for case in cases:
                measure(case, place)
            number = 0
            while done < count:
                rng = random.Random(f"{seed} {kind} {number}")
                case = cases[number % len(cases)]
                kills = min(rng.randint(1, _MOST_KILLS), count - done)
                for wrong in attack(case, rng, kills, place):
                    failures.append(f"{case.kind}, seed {seed}, round {number}: {wrong}")
                done += kills
                number += 1
        took = time.monotonic() - began
        print(f"{kind}: {done} kills in {took:.0f} s", file=sys.stderr)
    return failures


def _main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--kinds", nargs="+", choices=list(CASES), default=list(CASES))
    options = parser.parse_args()
    failures = run(options.seed, options.count, tuple(options.kinds))
    print(*failures, sep="\n")
    print(f"{len(failures)} failures")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(_main())
