"""What the law for fast motion costs: steps under it beside those under the quasi-static one.

    python benchmarks/dynamic_law.py

A ball that falls and comes to rest, Gymnasium's Ant and the package's hexapod with random controls,
1,500 steps each with `Sand.step`; medians of turns in which the laws alternate.
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np

from mjgranular import Sand
from mjgranular.models import Hexapod

LAWS = ("rft3d", "rft3d inertia=1.1 added=2.5", "rft3d_dynamic")
STEPS, HELD = 1500, 10  # and number of steps that controls are held

BALL = """
<mujoco>
  <option timestep="2e-3"/>
  <worldbody>
    <body pos="0 0 .02"><freejoint/><geom type="sphere" size=".02" mass=".1"/></body>
  </worldbody>
</mujoco>
"""


def robots() -> dict[str, tuple[mujoco.MjModel, dict[str, Any]]]:
    """Return models and the sand under them."""
    file = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets" / "ant.xml"
    ant = mujoco.MjModel.from_xml_path(str(file))
    ant.opt.integrator, ant.opt.timestep = mujoco.mjtIntegrator.mjINT_IMPLICITFAST, 0.005
    under = {"medium": "quikrete_medium", "instead_of": ["floor"], "resolution": 4}
    poppy = {"medium": "poppy_seed_loose"}
    return {
        "ball": (mujoco.MjModel.from_xml_string(BALL), poppy),
        "Ant": (ant, under),
        "hexapod": (Hexapod().spec(0.005).compile(), poppy),
    }


def seconds_a_step(model: mujoco.MjModel, sand: Sand) -> float:
    """Return the mean time per step over a run from the start [s]."""
    data, random = mujoco.MjData(model), np.random.default_rng(0)
    controls = random.uniform(-1, 1, (STEPS // HELD, model.nu))
    begin = time.perf_counter()
    for step in range(STEPS):
        if step % HELD == 0:
            data.ctrl[:] = controls[step // HELD]
        sand.step(data)
    return (time.perf_counter() - begin) / STEPS


def main() -> None:
    """Print microseconds per step, and the ratio to those of the quasi-static law."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--turns", type=int, default=7)
    turns = parser.parse_args().turns
    for name, (model, under) in robots().items():
        sands = {law: Sand(model, law=law, scheme="implicit", **under) for law in LAWS}
        found: dict[str, list[float]] = {law: [] for law in LAWS}
        for _ in range(turns):
            for law, sand in sands.items():
                found[law].append(1e6 * seconds_a_step(model, sand))
        median = {law: statistics.median(times) for law, times in found.items()}
        for law, value in median.items():
            print(f"{name}, {law}: {value:.1f} us, {value / median['rft3d']:.2f} x")


if __name__ == "__main__":
    main()
