"""Cost of sand in MuJoCo Warp: a robot in many worlds on its floor, on sand, and in our batch.

    python benchmarks/worlds.py --device cuda:0 --worlds 4096
    python benchmarks/worlds.py --device cpu --worlds 64 --names Hopper

Robots have fallen to the ground and move at random. The integrator is `discrete` everywhere; costs
are per step of one world. Cases take turns; reported are the medians, and those of the ratios to
the first case of a turn. On a GPU the steps are one graph.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import tyro
import warp as wp
from measure import Case, Effort, Group, machine, measure
from mujoco.batch import Batch
from rich.console import Console
from rich.table import Table

from mjgranular.envs import tasks
from mjgranular.envs.ground import place, quiet
from mjgranular.warp import WarpSand, coupled

SETTLED = 0.5  # time to fall before the measurement [s]


@dataclass(frozen=True)
class Options:
    """Cost of sand in MuJoCo Warp."""

    names: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME...")] = (
        "Hopper",
        "Ant",
        "Hexapod",
    )
    """Environments."""
    worlds: int = 64
    """Worlds."""
    device: str | None = None
    """Of Warp's; a GPU where there is one."""
    steps: int = 20
    """Steps of a turn."""
    turns: int = 5
    """Turns that count."""


def on_floor(name: str) -> mujoco.MjSpec:
    """Return an environment's robot on a rigid floor."""
    spec = tasks[name]().scene()
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    spec.option.solver = mujoco.mjtSolver.mjSOL_NEWTON  # MuJoCo Warp has no PGS
    if not any(geom.type == mujoco.mjtGeom.mjGEOM_PLANE for geom in spec.worldbody.geoms):
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
    return spec


class InWarp:
    """A model in many worlds of MuJoCo Warp that move at random."""

    def __init__(self, spec: mujoco.MjSpec, options: Options, sand: Any = None) -> None:
        model = coupled(spec).compile()
        self.put = None if sand is None else WarpSand(model, sand)
        with wp.ScopedDevice(options.device):
            self.m = mjw.put_model(model)
            self.d = mjw.put_data(model, mujoco.MjData(model), nworld=options.worlds)
            if self.put is not None:
                self.put.attach(self.m, self.d)
        self.device, self.count = self.d.qpos.device, options.steps
        random = np.random.default_rng(0)
        ctrl = random.uniform(-1, 1, (options.worlds, model.nu))
        self.d.ctrl.assign(ctrl.astype(np.float32))
        begun = time.perf_counter()
        mjw.step(self.m, self.d)
        wp.synchronize_device(self.device)
        self.first = time.perf_counter() - begun
        for _ in range(round(SETTLED / model.opt.timestep)):
            mjw.step(self.m, self.d)
        self.start = [getattr(self.d, name).numpy() for name in ("qpos", "qvel")]
        self.graph = None
        if self.device.is_cuda:
            with wp.ScopedCapture(self.device) as capture:
                self.steps()
            self.graph = capture.graph

    def begin(self) -> None:
        """Reset all worlds to their state after the fall."""
        for name, value in zip(("qpos", "qvel"), self.start, strict=True):
            getattr(self.d, name).assign(value)
        wp.synchronize_device(self.device)

    def steps(self) -> None:
        """Step all worlds."""
        for _ in range(self.count):
            mjw.step(self.m, self.d)

    def run(self) -> None:
        """Step all worlds, and wait for the end."""
        if self.graph is None:
            self.steps()
        else:
            wp.capture_launch(self.graph)
        wp.synchronize_device(self.device)


class OnProcessor:
    """The same environment's simulations in a MuJoCo batch, with sand inside `mj_step`."""

    def __init__(self, name: str, options: Options) -> None:
        model = tasks[name]().model
        self.batch, self.count = Batch(model, options.worlds), options.steps
        random = np.random.default_rng(0)
        self.batch.bind("ctrl")[:] = random.uniform(-1, 1, (options.worlds, model.nu))
        self.batch.step(nstep=round(SETTLED / model.opt.timestep))
        self.state = [self.batch.bind(each) for each in ("qpos", "qvel")]
        self.start = [values.copy() for values in self.state]

    def begin(self) -> None:
        """Reset all simulations to their state after the fall."""
        for values, start in zip(self.state, self.start, strict=True):
            values[:] = start

    def run(self) -> None:
        """Step all simulations, on all cores."""
        self.batch.step(nstep=self.count)


def group(name: str, options: Options, told: Callable[[str], object]) -> Group:
    """Return the group of cases of an environment."""

    def prepare() -> list[Case]:
        count = options.worlds * options.steps
        made: dict[str, Any] = {"its own floor": InWarp(on_floor(name), options)}
        for words, memory in (("sand", None), ("sand that remembers", True)):
            spec, task = on_floor(name), tasks[name](memory=memory)
            (sand,) = place(spec, task.sands)
            with quiet():
                made[words] = InWarp(spec, options, sand)
        made["sand in mj_step, MuJoCo's batch"] = OnProcessor(name, options)
        told(
            ", ".join(
                f"{words} {each.first:.1f} s"
                for words, each in made.items()
                if isinstance(each, InWarp)
            )
        )
        return [Case(words, each.begin, each.run, count) for words, each in made.items()]

    return Group(name, "", prepare)


def main() -> None:
    """Print a table."""
    options, console = tyro.cli(Options), Console()
    wp.config.log_level = wp.LOG_ERROR
    device = wp.get_device(options.device)
    table = Table("environment", "case", "µs a step and world", "ratio")
    for name in options.names:
        found = measure(
            group(
                name, options, lambda words, of=name: console.print(f"{of}, first step: {words}")
            ),
            Effort(turns=options.turns, seconds=0.0),
        )
        for words, figure in found.items():
            spread = f"{figure.ratio:.2f} ({figure.ratio_low:.2f} to {figure.ratio_high:.2f})"
            table.add_row(name, words, f"{figure.cost:.3g}", spread)
    console.print(table)
    batch = f"the batch on {os.cpu_count()} cores, {machine()}"
    console.print(f"{options.worlds} worlds on {device.name}; {batch}")


if __name__ == "__main__":
    main()
