"""Kill commands at random moments, and start them again: nothing may be lost or mixed.

Each of `impact`, `sweep` and `train` is started in a folder, killed up to four times and restarted
each time, then left to finish. Half of the kills come after a random time, half at a random file
operation, where a crash hurts most; one in four is a SIGTERM, and one in four of a sweep hits a
worker process, which the sweep must survive. After each kill the folder must hold the old result or
the new one, and every row and checkpoint that was there before. In the end the result must be
bit-identical to that of an undisturbed command, and no process and no file of a killed one may be
left.
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
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from seeds import SEED, cases

from mjgranular._util.result_folder import CONFIG
from mjgranular.cli.main import main
from mjgranular.errors import GranularError
from mjgranular.experiment import Impact, run_impact
from mjgranular.experiment.folder import read_impact
from mjgranular.pool import UNFINISHED

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not hasattr(os, "fork"), reason="forks"),
]

OPERATIONS = ("replace", "rename", "fsync", "unlink", "mkdir", "rmdir", "open")
MOST_KILLS = 4
WAIT = 600.0  # [s], after which a command hangs
LOG, TALLY = Path("child-log"), Path("tally")  # output of a child, number of its file operations


@dataclass
class Command:
    """A command to kill.

    Attributes:
        arguments: its arguments in the folder `out`, whose content decides whether it resumes.
        look: checks the folder after a kill; raises if something is incomplete, and returns the
            progress.
        result: returns the result, for comparison with that of an undisturbed command.
        prepare: arguments of a command that fills the folder before the first start.
        same: whether results must also be the same after a SIGTERM.
        once: whether it fails in a folder that holds its result.
        workers: whether it has worker processes.
    """

    arguments: Callable[[], list[str]]
    look: Callable[[], float]
    result: Callable[[], Any]
    prepare: tuple[str, ...] = ()
    same: bool = True
    once: bool = False
    workers: bool = False
    seconds: float = 0.0
    operations: int = 0
    expected: Any = None


OUT = Path("out")


def impact() -> Command:
    """Return a drop that replaces the result of another."""
    quick = ("impact", "--timestep", "1e-4", "--duration", "0.05", "--json", "--out", str(OUT))
    known: dict[float, Any] = {}

    def result() -> Any:
        done, summary, trajectory, _ = read_impact(OUT)  # at least the old one
        assert done.speed == summary["speed"]
        return done, summary, trajectory.table().tobytes()

    def look() -> float:
        done, *whole = result()
        assert known.setdefault(done.speed, whole) == whole, "mixed"
        return 0.0

    start = [*quick, "--overwrite", "--speed", "4"]
    return Command(lambda: start, look, result, prepare=(*quick, "--speed", "2"))


def sweep(workers: int) -> Command:
    """Return a sweep, in this process or in others."""
    quick = ["sweep", "--vary", "speed=1:10:6", "--of", "impact --timestep 4e-5 --duration 0.05"]
    start = [*quick, "--json", "--workers", str(workers), "--out", str(OUT)]

    def result() -> str:
        assert not (OUT / UNFINISHED).exists()
        assert json.loads((OUT / CONFIG).read_text())["config"]["interrupted"] is False
        return (OUT / "sweep.csv").read_text()

    def look() -> float:
        with suppress(FileNotFoundError):
            lines = (OUT / UNFINISHED).read_text().split("\n")[1:-1]
            expected = [*csv.DictReader(command.expected.splitlines())]
            for line in map(json.loads, lines):
                depth = float(expected[line["index"]]["depth"])
                assert line["row"]["depth"] == depth, "another row"
            return len(lines)
        with suppress(FileNotFoundError):
            return float(json.loads((OUT / "summary.json").read_text())["finished"])
        return 0.0

    command = Command(lambda: start, look, result, once=True, workers=workers > 1)
    return command


FEW = {
    "ppo": ("n_steps=32", "batch_size=64", "n_epochs=1"),
    "sac": ("learning_starts=32", "buffer_size=1000", "train_freq=16", "gradient_steps=1"),
}


def train(algorithm: str) -> Command:
    """Return a training."""
    from mjgranular.learn import train as _training  # noqa: F401  imported once, for all children
    from mjgranular.learn.policies import load_policy
    from mjgranular.learn.run import open_run

    few = ["num_envs=2", "checkpoint_every=64", "total_steps=320", "net=[8,8]", *FEW[algorithm]]
    start = ["train", "Pendulum-v1", "--algorithm", algorithm, "--json", "--out", str(OUT)]

    def arguments() -> list[str]:
        if (OUT / CONFIG).exists():
            return ["train", "--resume", str(OUT), "--json"]
        return [*start, "--set", *few]

    def result() -> Any:
        newest = open_run(OUT).newest_checkpoint()
        assert newest is not None
        for name in ("policy.zip", "normalizer.json", "curve.csv"):
            assert (OUT / name).read_bytes() == (newest / name).read_bytes(), name
        state = load_policy(OUT).model.state_dict()
        numbers = np.concatenate([value.numpy().ravel() for value in state.values()])
        return numbers.tobytes(), (OUT / "normalizer.json").read_text()

    def look() -> float:
        """Return the steps of the newest checkpoint, 0 without a run."""
        if not (OUT / CONFIG).exists():
            return 0.0
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # a damaged checkpoint
            run = open_run(OUT)
            if run.checkpoints():
                load_policy(OUT)
            return run.steps()

    return Command(arguments, look, result, same=False)


COMMANDS: dict[str, Callable[[], Command]] = {
    "impact": impact,
    "sweep-1": functools.partial(sweep, 1),
    "sweep-2": functools.partial(sweep, 2),
    **{f"train-{name}": functools.partial(train, name) for name in FEW},
}


# Children


def start(arguments: list[str], *, crash_at: int = 0) -> int:
    """Start a command in a fork of this process, and return its id.

    Args:
        arguments: arguments of the command.
        crash_at: number of the file operation at which it kills itself; 0 for never.
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
        signal.signal(signal.SIGTERM, signal.SIG_DFL)  # Ray, once imported, has its own
        descriptor = os.open(LOG, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(descriptor, 1)
        os.dup2(descriptor, 2)
        sys.stdout = os.fdopen(1, "w", closefd=False)
        sys.stderr = os.fdopen(2, "w", closefd=False)
        count = count_operations(crash_at)
        status = main(arguments)
        TALLY.write_text(str(count[0]))
    except SystemExit as stop:
        status = stop.code if isinstance(stop.code, int) else 1
    except BaseException as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
    finally:
        with suppress(BaseException):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(status)


def count_operations(crash_at: int) -> list[int]:
    """Count file operations from now on; at one of them the process kills itself."""
    count = [0]

    def counted(original: Callable[..., Any]) -> Callable[..., Any]:
        def operation(*args: Any, **kwargs: Any) -> Any:
            count[0] += 1
            if count[0] == crash_at:
                os.kill(os.getpid(), signal.SIGKILL)
            return original(*args, **kwargs)

        return operation

    for name in OPERATIONS:
        setattr(os, name, counted(getattr(os, name)))
    return count


def wait(pid: int, seconds: float) -> int | None:
    """Return the status of a child that ends in time, else None."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.005)
    return None


def processes_of(session: int) -> Iterator[int]:
    """Yield the processes of a session that still run."""
    for entry in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            fields = (entry / "stat").read_text().rpartition(")")[2].split()
            if int(fields[3]) == session and fields[0] != "Z":
                yield int(entry.name)


def is_done(command: Command, status: int | None) -> bool:
    """Return True if the command had finished, so that the same command is an error."""
    return command.once and status == 2 and "holds a result already" in LOG.read_text()


# Tests


@functools.cache
def undisturbed(name: str) -> Command:
    """Run a command undisturbed, for its duration, number of operations, and result."""
    command = COMMANDS[name]()
    if not name.startswith("train"):  # what the commands, forks of this process, need compiled
        run_impact(Impact(timestep=1e-4, duration=0.05))
    began = time.monotonic()
    status = wait(start(command.arguments()), WAIT)
    command.seconds = time.monotonic() - began
    assert status == 0, (status, LOG.read_text())
    command.operations = int(TALLY.read_text())
    command.expected = command.result()
    return command


def kill_once(command: Command, rng: random.Random) -> tuple[str, int | None]:
    """Start a command and kill it; return how, and its status."""
    moment, how = rng.uniform(0.0, 1.1) * command.seconds, rng.random()
    if how < 0.25:
        pid, how = start(command.arguments()), "SIGTERM"
        status = wait(pid, moment)
        if status is None:
            os.kill(pid, signal.SIGTERM)
            status = wait(pid, WAIT)
    elif how < 0.5 and command.workers:
        pid, how = start(command.arguments()), "a worker killed"
        status = wait(pid, moment)
        workers = [each for each in processes_of(pid) if each != pid]
        if status is None and workers:
            with suppress(ProcessLookupError):
                os.kill(rng.choice(workers), signal.SIGKILL)
        status = wait(pid, WAIT) if status is None else status
    elif how < 0.7:
        at = rng.randrange(1, command.operations + 1)
        pid, how = start(command.arguments(), crash_at=at), f"operation {at}"
        status = wait(pid, WAIT)
    else:
        pid, how = start(command.arguments()), "SIGKILL"
        status = wait(pid, moment)
        if status is None:
            os.kill(pid, signal.SIGKILL)
            status = wait(pid, WAIT)
    if status is None:
        os.kill(pid, signal.SIGKILL)
        wait(pid, WAIT)
        pytest.fail(f"{how}: the command did not end")
    until = time.monotonic() + WAIT
    while (left := [*processes_of(pid)]) and time.monotonic() < until:
        time.sleep(0.05)
    assert not left, f"after {how}: processes are left"
    return how, status


@pytest.mark.parametrize("name", COMMANDS)
def test_killed_commands_lose_nothing(
    name: str, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path_factory.mktemp("kills"))
    if name.startswith("train"):
        pytest.importorskip("stable_baselines3")
    command = undisturbed(name)
    for number in range(cases(1)):
        disturb(command, random.Random(f"{SEED} {name} {number}"), f"seed {SEED}, round {number}")


def disturb(command: Command, rng: random.Random, which: str) -> None:
    """Kill a command several times, let it finish, and compare its result."""
    shutil.rmtree(OUT)
    if command.prepare:
        assert wait(start([*command.prepare]), WAIT) == 0
    reached, terminated = 0.0, False
    for _ in range(rng.randint(1, MOST_KILLS)):
        how, status = kill_once(command, rng)
        terminated |= how == "SIGTERM"
        if is_done(command, status):
            break
        expected = {"SIGTERM": (0, -15, 143), "a worker killed": (0,)}.get(how, (0, -9))
        assert status in expected, f"{which}, {how}: {status}: {LOG.read_text()[-300:]}"
        try:
            now = command.look()
        except (GranularError, AssertionError, ValueError, Warning) as error:
            pytest.fail(f"{which}, after {how}: {type(error).__name__} {str(error)[:300]}")
        assert now >= reached, f"{which}, after {how}: {now:g} are there of {reached:g}"
        reached = now
    status = wait(start(command.arguments()), WAIT)
    assert status == 0 or is_done(command, status), f"{which}: {status}: {LOG.read_text()[-300:]}"
    if command.same or not terminated:
        assert command.result() == command.expected, which
    # A lock without a holder is left by a process that was killed after its work was done.
    assert not [path for path in OUT.rglob(".*") if path.name != ".lock"], which
