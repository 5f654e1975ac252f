"""How far a hexapod walks on sand that remembers, by the size of cells and its direction.

    python benchmarks/walk_on_prints.py
    python benchmarks/walk_on_prints.py --cells 0.02 0.01 --seconds 8

A tripod gait of the robot of `mjgranular/Hexapod-v0`, on loose poppy seeds; the way is that of the
trunk after it has stood for a second. Prints the rows of the table in docs/memory.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import mujoco
import numpy as np
import tyro

from mjgranular import add_sand
from mjgranular.envs.gaits import tripod
from mjgranular.models.hexapod import Hexapod


@dataclass(frozen=True)
class Options:
    """Ways of a hexapod on sand that remembers."""

    cells: Annotated[tuple[float, ...], tyro.conf.arg(metavar="M...")] = (0.02, 0.01, 0.005)
    """Sides of cells [m]."""
    seconds: float = 8.0
    """Of the walk."""


def way(seconds: float, *, turn: float, cell: float | None) -> float:
    """Return the distance that it walks [m].

    Args:
        seconds: duration of the walk [s].
        turn: heading of the robot relative to the grid [rad].
        cell: side of a cell [m]; None for sand without memory.
    """
    robot = Hexapod()
    spec = robot.spec(0.005)
    sand = {"medium": "poppy_seed_loose", "law": "rft2d", "resolution": 2, "instead_of": "floor"}
    add_sand(spec, **sand, memory=cell)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = robot.start()
    data.qpos[3], data.qpos[6] = math.cos(turn / 2), math.sin(turn / 2)
    mujoco.mj_step(model, data, 200)
    start = data.qpos[:2].copy()
    for k in range(round(seconds / 0.04)):
        data.ctrl[:] = 0.6 * np.asarray(tripod(0.04 * k, model.nu))
        mujoco.mj_step(model, data, 8)
    return float(np.linalg.norm(data.qpos[:2] - start))


def main(options: Options) -> None:
    """Print the distances."""
    for degrees in (0, 45):
        for cell in (None, *options.cells):
            length = way(options.seconds, turn=math.radians(degrees), cell=cell)
            sand = "without memory" if cell is None else f"cells of {1e3 * cell:g} mm"
            print(f"{degrees:2} degrees, {sand}: {length:.4f} m", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
