"""Kill workers of a study, and interrupt it: its table must stay bit-identical.

Even cases kill two worker processes at random moments, of `local` and Ray in turn. Odd cases
interrupt the study at random rows and resume it with the other engine each time. Needs Linux, and
the extra `ray` for that engine.
"""

from __future__ import annotations

import importlib.util
import itertools
import multiprocessing
import os
import random
import shutil
import signal
import tempfile
import threading
from argparse import Namespace
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from attacks.worker import Case, Finding, Note, Result

from mjgranular.experiment import Between, Impact, Study, journal_of, run_study
from mjgranular.experiment.table import write_csv
from mjgranular.pool import UNFINISHED, Workers
from mjgranular.pool.workers import Engine

PATIENCE = 600.0
DROPS = 60
STUDY = Study(
    Impact(speed=2.0, timestep=1e-4, scheme="explicit"),  # about 4 ms per drop
    {"speed": Between(1.0, 5.0), "angle": Between(0.6, 1.0)},
    sample=DROPS,
)
_ALONE = Path("alone.csv")
_ENGINES: tuple[Engine, ...] = ("local", "ray") if importlib.util.find_spec("ray") else ("local",)


def cases(options: Namespace, numbers: range) -> list[Case]:
    """List cases: a case depends only on its seed and number."""
    return [{"seed": options.seed, "number": number} for number in numbers]


def prepare() -> None:
    """Compute the table in one process, and start Ray."""
    with tempfile.TemporaryDirectory() as folder:
        table(Workers(count=1), Path(folder), lambda _finished: None)
        shutil.copyfile(Path(folder) / "table.csv", _ALONE)
    if "ray" in _ENGINES:
        import ray

        ray.init(address="local", num_cpus=4, include_dashboard=False, log_to_driver=False)


def finish() -> None:
    """Stop Ray."""
    if "ray" in _ENGINES:
        import ray

        ray.shutdown()


def attempt(case: Case, note: Note) -> Result:
    """Disturb the study, and compare its table."""
    rng, number = random.Random(f"{case['seed']} {case['number']}"), case["number"]
    engine = _ENGINES[number // 2 % len(_ENGINES)]
    note(engine)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        disturb = interrupted if number % 2 else killed
        counts = disturb(engine, folder, rng)
        rows = (folder / UNFINISHED).read_text().count("\n") - 1
        equal = (folder / "table.csv").read_bytes() == _ALONE.read_bytes()
    kind, result = f"{disturb.__name__} on {engine}", Result(counts=counts)
    if rows != DROPS:
        result.findings.append(Finding(kind, f"the journal has {rows} rows of {DROPS}"))
    if not equal:
        result.findings.append(Finding(kind, "the table is not that of one process"))
    return result


def killed(engine: Engine, folder: Path, rng: random.Random) -> dict[str, int]:
    """Kill two workers. Three kills at one chunk would correctly end it."""
    moments = sorted(rng.sample(range(1, DROPS - 10), 2))
    timers: list[threading.Timer] = []
    killed: list[int] = []

    def kill() -> None:
        with suppress(OSError, IndexError):
            killed.append(rng.choice(processes(engine)))
            os.kill(killed[-1], signal.SIGKILL)

    def progress(finished: int) -> None:
        while moments and finished >= moments[0]:
            moments.pop(0)
            timers.append(threading.Timer(rng.uniform(0.0, 0.1), kill))
            timers[-1].start()

    table(Workers(engine, 2, 3), folder, progress)
    for timer in timers:
        timer.join()
    return {f"workers of {engine} killed": len(killed)}


def interrupted(engine: Engine, folder: Path, rng: random.Random) -> dict[str, int]:
    """Interrupt the study after some rows, until it ends; change the engine each time."""
    start = _ENGINES.index(engine)
    stop = 0
    for done in itertools.count():
        stop += rng.randint(1, 20)

        def progress(finished: int, stop: int = stop) -> None:
            if finished >= stop:
                raise KeyboardInterrupt

        if table(Workers(_ENGINES[(start + done) % len(_ENGINES)], 2, 3), folder, progress):
            return {"interruptions": done}
    return {}


def table(workers: Workers, folder: Path, progress: Callable[[int], None]) -> bool:
    """Run or resume the study; write its table and return True if it has finished."""
    journal = journal_of(STUDY, folder)
    journal.begin()
    result = run_study(STUDY, workers=workers, journal=journal, progress=progress)
    assert result.failed == 0, [result.told(one) for one in result.failures]
    ended = result.finished == DROPS
    if ended:
        write_csv(folder / "table.csv", result.columns(), result.rows)
    journal.close()
    return ended


def processes(engine: Engine) -> list[int]:
    """Return the ids of worker processes."""
    if engine == "local":
        return [child.pid for child in multiprocessing.active_children() if child.pid]
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if (entry / "cmdline").read_bytes().startswith(b"ray::_run"):
                found.append(int(entry.name))
    return found
