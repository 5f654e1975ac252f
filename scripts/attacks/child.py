"""A process that walks some models: what it does is written to files, so that it may crash.

python scripts/attacks/child.py FOLDER        # reads FOLDER/task.json
"""

from __future__ import annotations

import faulthandler
import json
import mmap
import os
import resource
import struct
import sys
import time
import traceback
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

TASK, RESULTS, PLACE = "task.json", "results.jsonl", "place"
PLACE_FORMAT = "=qqq"  # number, step, door
DOORS = ("step", "plugin", "bare")


class Place:
    """Where the process is, in memory that outlives it."""

    def __init__(self, path: Path) -> None:
        path.write_bytes(struct.pack(PLACE_FORMAT, -1, -1, 0))
        with path.open("r+b") as file:
            self._memory = mmap.mmap(file.fileno(), 0)
        self.number = -1

    def __call__(self, step: int, door: int) -> None:
        struct.pack_into(PLACE_FORMAT, self._memory, 0, self.number, step, door)


def main() -> None:
    """Does what `task.json` says."""
    faulthandler.enable()
    folder = Path(sys.argv[1])
    task = json.loads((folder / TASK).read_text())
    place = Place(folder / PLACE)
    os.chdir(folder)  # MuJoCo's log falls into the current folder
    with (folder / RESULTS).open("a") as results:

        def tell(**what: Any) -> None:
            results.write(json.dumps(what, default=str) + "\n")
            results.flush()

        if "warm" in task:
            for number, program in enumerate(task["warm"]):
                place(number, 0)
                compile_program(*program)
                tell(program=program)
            return
        for number in task["numbers"]:
            place.number = number
            place(-1, 0)
            tell(**walk_one(task, number, place))


def walk_one(task: dict[str, Any], number: int, place: Place) -> dict[str, Any]:
    """Walks a model; what was found, as JSON has it."""
    from attacks.draw import draw
    from attacks.finding import as_dict, failure
    from attacks.walk import Walk

    started = time.perf_counter()
    seed, steps = task["seed"], task["steps"]
    programs = tuple(tuple(program) for program in task["programs"])
    findings: list[dict[str, Any]] = []
    counts: dict[str, int] = {}
    try:
        drawn = draw(seed, number, steps, programs, task.get("kind"))
        walked = Walk(seed, number, steps, drawn, place=place, bare=task.get("bare", False))
        walked.run()
        walked.ask_twins()
        findings = [as_dict(finding) for finding in walked.findings]
        counts = dict(walked.counts)
    except Exception:  # of the attack itself
        findings.append(failure(seed, number, traceback.format_exc(limit=-3)))
    return {
        "number": number,
        "findings": findings,
        "counts": counts,
        "seconds": time.perf_counter() - started,
        "megabytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024,
    }


def compile_program(law: str, surface: str, scheme: str) -> None:
    """Has both doors' machine code compiled and kept."""
    import mujoco
    from attacks import models
    from attacks.draw import arguments

    from mjgranular import Sand
    from mjgranular.engine import add_sand

    places = {"plane": "None", "bed": "Bed('tray')", "height_field": "HeightField('dunes')"}
    place, _, remembers = surface.partition(" ")
    text = f"{models.LAWS[law][0]}, surface={places[place]}, scheme='{scheme}', geoms=['g']"
    text += ", memory=True" if remembers else ""
    given = arguments(text)
    model = mujoco.MjModel.from_xml_string(models.SMALLEST)
    Sand(model, **given).step(mujoco.MjData(model))
    spec = mujoco.MjSpec.from_string(models.SMALLEST)
    add_sand(spec, **given)
    model = spec.compile()
    mujoco.mj_step(model, mujoco.MjData(model))


if __name__ == "__main__":
    main()
