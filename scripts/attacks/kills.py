"""Kill commands at random moments, and restart them: nothing may be lost or mixed.

Each of `impact`, `sweep` and `train` is started in a folder, killed up to four times and restarted
each time, then left to finish. Half of the kills come after a random time, half at a random file
operation, where a crash hurts most; one in four is a SIGTERM. After each kill the folder must hold
the old result or the new one, and every row and checkpoint that was there before. In the end the
result must be bit-identical to that of an undisturbed command, and no process and no file of a
killed one may be left.
"""

from __future__ import annotations

import csv
import functools
import json
import os
import random
import shutil
import signal
import sys
import time
import warnings
from argparse import Namespace
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from attacks.worker import Case, Finding, Note, Result

import mjgranular  # noqa: F401  before mujoco: it chooses how to draw without a screen
from mjgranular._util.extras import require
from mjgranular.cli.main import main
from mjgranular.errors import GranularError
from mjgranular.experiment.folder import CONFIG, read_impact
from mjgranular.learn import train as _training  # noqa: F401  imported once, for all children
from mjgranular.learn.policies import load_policy
from mjgranular.learn.run import open_run
from mjgranular.pool import UNFINISHED

PATIENCE = 2400.0  # [s]
_OPERATIONS = ("replace", "rename", "fsync", "unlink", "mkdir", "rmdir", "open")
_MOST_KILLS = 4
_WAIT = 120.0  # [s]


@dataclass
class Command:
    """A command to kill.

    Attributes:
        arguments: returns its arguments for a folder, whose content decides whether it resumes.
        look: checks the folder after a kill; raises if something is incomplete, and returns the
            progress.
        result: returns the result, for comparison with that of an undisturbed command.
        same: whether results must also be the same after a SIGTERM.
        once: whether it fails in a folder that holds its result.
        prepare: fills the folder before the first start.
    """

    arguments: Callable[[Path], list[str]]
    look: Callable[[Path], float]
    result: Callable[[Path], Any]
    same: bool = True
    once: bool = False
    prepare: Callable[[Path], None] = lambda _folder: None
    seconds: float = 0.0
    operations: int = 0
    expected: Any = None


def cases(options: Namespace, numbers: range) -> list[Case]:
    """List rounds of the commands in turn, or of the requested ones."""
    names = options.commands or list(COMMANDS)
    rounds = [(number % len(names), number // len(names)) for number in numbers]
    return [{"seed": options.seed, "command": names[k], "round": round_} for k, round_ in rounds]


def prepare() -> None:
    """Check that everything is available."""
    require("matplotlib.figure", extra="figures", purpose="Drawing")


def attempt(case: Case, note: Note) -> Result:
    """Kill one command several times, then let it finish."""
    name, number = case["command"], case["round"]
    rng = random.Random(f"{case['seed']} {name} {number}")
    variants = COMMANDS[name]
    index = number % len(variants)
    note(f"{name}, variant {index}")
    kills = rng.randint(1, _MOST_KILLS)
    wrong = attack(undisturbed(name, index), rng, kills)
    findings = [Finding(f"{name} killed", text) for text in wrong]
    return Result(findings, {f"kills of {name}": kills})


# Commands


def impact(speed: str = "4") -> Command:
    """Return a drop that replaces the result of another."""
    quick = ["impact", "--timestep", "1e-4", "--duration", "0.05", "--json", "--overwrite"]

    def command(folder: Path) -> list[str]:
        return [*quick, "--speed", speed, "--out", str(folder)]

    def result(folder: Path) -> tuple[Any, ...]:
        done, summary, trajectory = read_impact(folder)
        assert (folder / "motion.png").stat().st_size > 1000
        return done, summary, trajectory.table().tobytes()

    known: dict[float, Any] = {}

    def look(folder: Path) -> float:
        done, summary, trajectory = read_impact(folder)  # at least the old one
        assert done.speed == summary["speed"]
        whole = summary, trajectory.table().tobytes()
        assert known.setdefault(done.speed, whole) == whole, "mixed"
        return 0.0

    def prepare(folder: Path) -> None:
        assert _wait(_child([*quick, "--speed", "2", "--out", str(folder)]), _WAIT) == 0

    return Command(command, look, result, prepare=prepare)


def sweep(workers: int) -> Command:
    """Return a sweep, in this process or in others."""
    quick = ["sweep", "--vary", "speed=1:10:12", "--of", "impact --timestep 2e-5 --duration 0.05"]

    def command(folder: Path) -> list[str]:
        return [*quick, "--json", "--workers", str(workers), "--out", str(folder)]

    def result(folder: Path) -> str:
        assert not (folder / UNFINISHED).exists()
        assert json.loads((folder / CONFIG).read_text())["config"]["interrupted"] is False
        return (folder / "sweep.csv").read_text()

    def look(folder: Path) -> float:
        with suppress(FileNotFoundError):
            lines = (folder / UNFINISHED).read_text().split("\n")[1:-1]
            expected = [*csv.DictReader(sweeping.expected.splitlines())]
            for line in map(json.loads, lines):
                there = float(expected[line["index"]]["depth"])
                assert line["row"]["depth"] == there, "another row"
            return len(lines)
        # Of a finished one.
        with suppress(FileNotFoundError):
            return float(json.loads((folder / "summary.json").read_text())["finished"])
        return 0.0

    sweeping = Command(command, look, result, once=True)
    return sweeping


_TRAIN = {
    "ppo": ("n_steps=32", "batch_size=64", "n_epochs=1"),
    "sac": ("learning_starts=32", "buffer_size=1000", "train_freq=16", "gradient_steps=1"),
    "td3": ("learning_starts=32", "buffer_size=1000", "train_freq=16", "gradient_steps=1"),
}


def train(algorithm: str) -> Command:
    """Return a training."""
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

    return Command(command, _steps, result, same=False)


def _steps(folder: Path) -> float:
    """Return the steps of the newest checkpoint of a run, 0 without a run."""
    if not (folder / CONFIG).exists():
        return 0.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a damaged checkpoint
        run = open_run(folder)
        if run.checkpoints():
            load_policy(folder)
        return run.steps()


COMMANDS: dict[str, list[Callable[[], Command]]] = {
    "impact": [impact],
    "sweep": [lambda: sweep(1), lambda: sweep(2)],
    "train": [functools.partial(train, name) for name in _TRAIN],
}


@functools.cache
def undisturbed(name: str, index: int) -> Command:
    """Run a command undisturbed, for its duration, number of operations, and result."""
    command = COMMANDS[name][index]()
    folder, tally = Path("undisturbed"), Path("tally")
    for _ in range(2):  # the first run may compile
        shutil.rmtree(folder, ignore_errors=True)
        began = time.monotonic()
        status = _wait(_child(command.arguments(folder), tally=tally), 10 * _WAIT)
        command.seconds = time.monotonic() - began
        assert status == 0, (status, LOG.read_text())
    command.operations = int(tally.read_text())
    command.expected = command.result(folder)
    shutil.rmtree(folder)
    return command


# Children

LOG = Path("child-log")  # output of the child


def _child(arguments: list[str], *, crash_at: int = 0, tally: Path | None = None) -> int:
    """Start a command in a fork of this process, and return its id.

    Args:
        arguments: arguments of the command.
        crash_at: number of the file operation at which it kills itself; 0 for never.
        tally: file for the number of its operations.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about forks with threads: none of ours holds a lock
        pid = os.fork()
    if pid:
        return pid
    status = 70
    try:
        os.setsid()
        signal.signal(signal.SIGINT, signal.default_int_handler)
        descriptor = os.open(LOG, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
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
    """Count file operations from now on; at one of them the process kills itself."""
    count = [0]

    def counted(original: Callable[..., Any]) -> Callable[..., Any]:
        def operation(*args: Any, **kwargs: Any) -> Any:
            count[0] += 1
            if count[0] == crash_at:
                os.kill(os.getpid(), signal.SIGKILL)
            return original(*args, **kwargs)

        return operation

    for name in _OPERATIONS:
        setattr(os, name, counted(getattr(os, name)))
    return count


def _wait(pid: int, seconds: float) -> int | None:
    """Return the status of a child that ends in time, else None."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.005)
    return None


def _left_behind(session: int) -> list[str]:
    """Return the command lines of a session's processes that still run."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            fields = (entry / "stat").read_text().rpartition(")")[2].split()
            if int(fields[3]) == session and fields[0] != "Z":
                found.append((entry / "cmdline").read_text().replace("\0", " ")[:100])
    return found


# The attack


def attack(command: Command, rng: random.Random, kills: int) -> list[str]:
    """Run one command and kill it several times; return what went wrong."""
    folder = Path("out")
    shutil.rmtree(folder, ignore_errors=True)
    command.prepare(folder)
    failures: list[str] = []
    reached, terminated = 0.0, False
    for _ in range(kills):
        by_term = rng.random() < 0.25
        at_operation = not by_term and rng.random() < 0.6
        crash_at = rng.randrange(1, command.operations + 1) if at_operation else 0
        how = f"operation {crash_at}" if at_operation else ("SIGTERM" if by_term else "SIGKILL")
        pid = _child(command.arguments(folder), crash_at=crash_at)
        status = _wait(pid, _WAIT if at_operation else rng.uniform(0.0, 1.1) * command.seconds)
        if status is None:
            terminated |= by_term
            os.kill(pid, signal.SIGTERM if by_term else signal.SIGKILL)
            status = _wait(pid, 30.0)
        if status is None:
            os.kill(pid, signal.SIGKILL)
            _wait(pid, 30.0)
            failures.append(f"{how}: did not end within 30 s of a SIGTERM")
        elif _is_done(command, status):
            break
        elif status not in (0, -9, -15, 143) or (status == -9 and by_term):
            failures.append(f"{how}: ended with {status}: {LOG.read_text()[-300:]}")
        try:
            now = command.look(folder)
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
    return failures + _end(command, folder, terminated)


def _is_done(command: Command, status: int | None) -> bool:
    """Return True if the command had finished, so that the same command is an error."""
    return command.once and status == 2 and "holds a result already (config.json" in LOG.read_text()


def _end(command: Command, folder: Path, terminated: bool) -> list[str]:
    """Let the command finish, and compare its result."""
    status = _wait(_child(command.arguments(folder)), _WAIT)
    if status != 0 and not _is_done(command, status):
        return [f"in the end: {status}: {LOG.read_text()[-300:]}"]
    try:
        result = command.result(folder)
    except (GranularError, AssertionError, OSError) as error:
        return [f"in the end: {type(error).__name__} {error}"]
    failures = []
    if (command.same or not terminated) and result != command.expected:
        failures.append("the result is not that of an undisturbed command")
    # A lock without a holder is left by a process that was killed after its work was done.
    hidden = [str(p.relative_to(folder)) for p in folder.rglob(".*") if p.name != ".lock"]
    if hidden:
        failures.append(f"left behind: {hidden}")
    return failures
