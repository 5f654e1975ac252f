"""Child processes that walk models in chunks: one may crash or hang, and the rest goes on."""

from __future__ import annotations

import json
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from attacks.child import DOORS, PLACE, PLACE_FORMAT, RESULTS, TASK
from attacks.draw import draw
from attacks.finding import failure

CHUNK = 20
HANGS = 120.0  # [s] in which nothing moves
COMPILES = 1200.0  # [s], the same of one that compiles
Program = tuple[str, str, str]


@dataclass
class Job:
    """One child at work."""

    process: subprocess.Popen[bytes]
    folder: Path
    task: dict[str, Any]
    read: int = 0  # bytes of its results
    done: int = 0  # of its numbers
    seen: bytes = b""
    since: float = 0.0

    def news(self) -> list[dict[str, Any]]:
        """What it has written since it was last asked."""
        path = self.folder / RESULTS
        raw = path.read_bytes()[self.read :] if path.exists() else b""
        whole = raw[: raw.rfind(b"\n") + 1]
        self.read += len(whole)
        rows = [json.loads(line) for line in whole.splitlines()]
        self.done += len(rows)
        return rows

    def hangs(self) -> bool:
        """Tells whether nothing has moved for long."""
        path = self.folder / PLACE
        now = path.read_bytes() if path.exists() else b""
        if now != self.seen:
            self.seen, self.since = now, time.monotonic()
        limit = COMPILES if "warm" in self.task else HANGS
        return time.monotonic() - self.since > limit

    def where(self) -> tuple[int, int, str]:
        """Number, step and door at which it is, or has come to an end."""
        raw = (self.folder / PLACE).read_bytes()
        number, step, door = struct.unpack(PLACE_FORMAT, raw)
        return number, step, DOORS[door]

    def last_words(self) -> str:
        return (self.folder / "stderr").read_text(errors="replace")[-2000:]


class Crew:
    """Runs tasks in so many processes at a time."""

    def __init__(self, jobs: int = 2) -> None:
        self.jobs = jobs
        self._folder = tempfile.TemporaryDirectory(prefix="attack-")
        self._started = 0

    def __enter__(self) -> Crew:
        return self

    def __exit__(self, *_: object) -> None:
        self._folder.cleanup()

    def warm(self, programs: Sequence[Program]) -> Iterator[dict[str, Any]]:
        """Has everything compiled that is going to be used."""
        shares = [list(programs[first :: self.jobs]) for first in range(self.jobs)]
        yield from self._run([{"warm": share} for share in shares if share])

    def walk(
        self,
        seed: int,
        numbers: Sequence[int],
        steps: int,
        programs: Sequence[Program],
        kind: str | None = None,
    ) -> Iterator[dict[str, Any]]:
        """Walks models; gives for each what its child has told, or how that has died."""
        common = {"seed": seed, "steps": steps, "programs": list(programs), "kind": kind}
        chunks = [numbers[first : first + CHUNK] for first in range(0, len(numbers), CHUNK)]
        yield from self._run([{**common, "numbers": list(chunk)} for chunk in chunks])

    def _run(self, tasks: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
        waiting, running = list(reversed(tasks)), []
        try:
            while waiting or running:
                while waiting and len(running) < self.jobs:
                    running.append(self._start(waiting.pop()))
                time.sleep(0.05)
                for job in list(running):
                    ended = job.process.poll() is not None
                    yield from job.news()
                    if ended:
                        running.remove(job)
                        yield from self._bury(job, waiting)
                    elif job.hangs():
                        job.process.kill()
        finally:
            for job in running:
                job.process.kill()
                job.process.wait()

    def _start(self, task: dict[str, Any]) -> Job:
        self._started += 1
        folder = Path(self._folder.name) / str(self._started)
        folder.mkdir()
        (folder / TASK).write_text(json.dumps(task))
        with (folder / "stderr").open("wb") as stderr:
            process = subprocess.Popen(
                [sys.executable, str(Path(__file__).with_name("child.py")), str(folder)],
                stdout=stderr,
                stderr=stderr,
            )
        return Job(process, folder, task, since=time.monotonic())

    def _bury(self, job: Job, waiting: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
        """What has become of a child; what it has left undone waits for another."""
        yield from job.news()
        code = job.process.returncode
        if code == 0:
            return
        if "warm" in job.task or job.done >= len(job.task["numbers"]):
            raise RuntimeError(f"a process ended with {code}: {job.last_words()}")
        number = job.task["numbers"][job.done]
        rest = job.task["numbers"][job.done + 1 :]
        if rest:
            waiting.append({**job.task, "numbers": rest})
        if job.task.get("bare"):
            yield {"number": number, "crashed": True}
            return
        _, step, door = job.where()
        name = "hangs" if job.hangs() else _name(code)
        alone = list(self._run([{**job.task, "numbers": [number], "bare": True}]))
        own = any(row.get("crashed") for row in alone)
        text = job.last_words().strip().splitlines()
        finding = failure(
            job.task["seed"],
            number,
            f"{text[0] if text else ''}{' (without sand too)' if own else ''}",
            step=step,
            door=door,
            kind=f"{name} (MuJoCo's own)" if own else name,
            failed=not own,
            about=self._about(job.task, number, step),
        )
        yield {"number": number, "findings": [finding], "counts": {}, "seconds": 0.0}

    @staticmethod
    def _about(task: dict[str, Any], number: int, step: int) -> dict[str, Any]:
        """What the process had before it when it ended."""
        programs = tuple(tuple(program) for program in task["programs"])
        drawn = draw(task["seed"], number, task["steps"], programs, task["kind"])
        events = drawn.plan.events.items()
        return {
            "kind of run": drawn.kind,
            "program": " ".join(drawn.model.program),
            "recent": {at: lines for at, lines in sorted(events) if step - 12 < at <= step},
        }


def _name(code: int) -> str:
    try:
        return signal.Signals(-code).name
    except ValueError:
        return f"exit code {code}"
