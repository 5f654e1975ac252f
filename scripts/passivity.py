"""Weighs the work of sand in MuJoCo Warp on random models: it is to take energy, never to give any.

    python scripts/passivity.py                     # 200 models, all laws on all surfaces
    python scripts/passivity.py --seed 7 --models 20

Models are those of `scripts/attack.py`, with the integrator `discrete`. Each is stepped in several
worlds with different initial velocities. After each step the work of the sand is computed in double
precision with the velocity at the end of the step, by MuJoCo's kinematics:

- of the forces that `WarpSand` reports;
- of the forces that act on the bodies, by MuJoCo's inverse dynamics, if no constraint and no
  actuator is active. The relative precision of a velocity is 6e-8, so that the kinetic energy
  changes by such a part in any step, even without sand.

MuJoCo Warp recompiles for each number of degrees of freedom: only models with a few different
numbers are drawn.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp
from rich.console import Console
from rich.progress import track

sys.path.insert(0, str(Path(__file__).resolve().parent))

from attacks import models
from attacks.draw import arguments

from mjgranular import InputError
from mjgranular.warp import WarpSand, coupled

PROGRAMS = tuple(
    (law, surface, scheme)
    for law, surface, scheme in models.PROGRAMS
    if scheme == "implicit" and "memory" not in surface
)
SIZES = (9, 12, 18)
WORLDS, STEPS = 4, 30
BAR = 1e-6  # in parts of the kinetic energy
JOULES = 1e-9  # least kinetic energy of a step that counts


@dataclass
class Weighed:
    """Results for a model's steps.

    Attributes:
        told: largest work of the forces that the sand reports, in parts of the kinetic energy.
        felt: largest work of the forces that act on the bodies.
        given: sum of positive works [J].
        taken: sum of negative works [J].
        counts: numbers of steps, by kind.
    """

    told: float = -np.inf
    felt: float = -np.inf
    given: float = 0.0
    taken: float = 0.0
    counts: Counter[str] = field(default_factory=Counter)


def draw(seed: int, number: int, sizes: tuple[int, ...]) -> tuple[str, mujoco.MjModel]:
    """Draw a model that MuJoCo Warp supports, with a number of degrees of freedom in `sizes`.

    Returns:
        Arguments of the sand as a string, and the model.
    """
    rng = np.random.default_rng([seed, number])
    while True:
        drawn = models.draw(rng, PROGRAMS[number % len(PROGRAMS)])
        spec = mujoco.MjSpec.from_string(drawn.xml)
        option = spec.option
        option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
        option.noslip_iterations = option.enableflags = 0
        option.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        if option.solver == mujoco.mjtSolver.mjSOL_PGS:
            option.solver = mujoco.mjtSolver.mjSOL_NEWTON
        model = coupled(spec).compile()
        if model.nv not in sizes:
            continue
        try:
            mjw.put_model(model)
        except (NotImplementedError, ValueError):  # not supported in MuJoCo Warp
            continue
        return drawn.sand, model


def weigh(seed: int, number: int, *, steps: int = STEPS, sizes: tuple[int, ...] = SIZES) -> Weighed:
    """Step a model, and measure the sand's work in each step."""
    given, model = draw(seed, number, sizes)
    rng = np.random.default_rng([seed, number, 1])
    sand = WarpSand(model, **arguments(given))
    m, data = mjw.put_model(model), mujoco.MjData(model)
    d = mjw.put_data(model, data, nworld=WORLDS, nconmax=100, njmax=400)
    sand.attach(m, d)
    m.opt.warn_overflow = 0
    speeds = np.array([0.0, 0.1, 1.0, 5.0])[:, None]
    d.qvel.assign((speeds * rng.normal(size=(WORLDS, model.nv))).astype(np.float32))
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_INVDISCRETE
    weighed = Weighed()
    for _ in range(steps):
        before = [field.numpy().astype(float) for field in (d.qpos, d.qvel)]
        mjw.step(m, d)
        after = d.qvel.numpy().astype(float)
        wrenches = np.concatenate([sand.force.numpy(), sand.moment.numpy()], 2).astype(float)
        for world in range(WORLDS):
            state = (before[0][world], before[1][world], after[world])
            if all(np.isfinite(each).all() for each in state) and wrenches[world].any():
                _weigh_step(model, data, state, sand.bodies, wrenches[world], weighed)
    weighed.counts["worlds lost"] += len(sand.bad_worlds(d))
    return weighed


def _weigh_step(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    state: tuple[np.ndarray, np.ndarray, np.ndarray],
    bodies: tuple[str, ...],
    wrenches: np.ndarray,
    weighed: Weighed,
) -> None:
    """Measure the work in one step of one world."""
    h = model.opt.timestep
    data.qpos, data.qvel, end = state
    data.qacc = (end - state[1]) / h
    mujoco.mj_inverse(model, data)
    kinetic, product = 0.0, np.zeros(model.nv)
    for v in state[1:]:
        mujoco.mj_mulM(model, data, product, v)
        kinetic = max(kinetic, 0.5 * float(v @ product))
    if kinetic < JOULES:
        weighed.counts["at rest"] += 1
        return
    force = np.zeros(model.nv)
    for name, wrench in zip(bodies, wrenches, strict=True):
        body = model.body(name).id
        mujoco.mj_applyFT(model, data, wrench[:3], wrench[3:], data.xipos[body], body, force)
    work = h * float(force @ end)
    weighed.counts["weighed"] += 1
    weighed.told = max(weighed.told, work / kinetic)
    weighed.given += max(work, 0.0)
    weighed.taken -= min(work, 0.0)
    if not data.nefc and not model.nu:
        weighed.counts["by inverse dynamics"] += 1
        weighed.felt = max(weighed.felt, h * float(data.qfrc_inverse @ end) / kinetic)


def main() -> int:
    """Measure models, and print the results."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--models", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="number of the first model")
    parser.add_argument("--steps", type=int, default=STEPS, help="of each model")
    options, console = parser.parse_args(), Console()
    wp.config.log_level = wp.LOG_ERROR
    warnings.simplefilter("ignore")
    found: dict[int, Weighed] = {}
    numbers = range(options.first, options.first + options.models)
    for number in track(numbers, console=console):
        try:
            found[number] = weigh(options.seed, number, steps=options.steps)
        except InputError as error:
            console.print(f"{number}: refused: {error}", markup=False)
            continue
        each = found[number]
        if max(each.told, each.felt) > BAR:
            console.print(f"{number}: told {each.told:.2g}, felt {each.felt:.2g}", markup=False)
    counts = sum((each.counts for each in found.values()), Counter())
    console.print(f"{len(found)} models, {dict(counts)}", markup=False)
    for what in ("told", "felt"):
        values = np.array([getattr(each, what) for each in found.values()])
        console.print(
            f"greatest work of forces that are {what}: {values.max():.2g} of the kinetic energy; "
            f"{(values > BAR).sum()} models above {BAR:g}"
        )
    given, taken = (
        sum(getattr(each, what) for each in found.values()) for what in ("given", "taken")
    )
    console.print(f"energy given {given:.2g} J, taken {taken:.3g} J")
    return int(any(each.told > BAR for each in found.values()))


if __name__ == "__main__":
    sys.exit(main())
