"""Draw events for a running simulation: controls, switched options, hostile numbers.

An event is a line of Python with the names `model`, `data`, `mujoco`, `np` and `random` (a seeded
generator), so that a list of events can be read, repeated and pasted.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterator
from contextlib import suppress

import mujoco
import numpy as np
from attacks import models
from attacks.cases import ModelCase

FLAGS = len(mujoco.mjtDisableBit.__members__) - 1
ENABLES = len(mujoco.mjtEnableBit.__members__) - 1

OPTIONS = (
    *(f"model.opt.jacobian = {value}" for value in (0, 1, 2)),
    *(f"model.opt.integrator = {value}" for value in (0, 2, 3)),
    *(f"model.opt.solver = {value}" for value in (0, 1, 2)),
    *(f"model.opt.cone = {value}" for value in (0, 1)),
    *(f"model.opt.tolerance = {value}" for value in ("0", "1e-4", "1e-12")),
    *(f"model.opt.timestep = {value}" for value in (1e-5, 1e-3, 4e-3, 1e-2)),
)  # fmt: skip
"""After any of these bodies at rest stay at rest."""

RARE_OPTIONS = (
    *(f"model.opt.integrator = {value}" for value in (1, 4)),  # RK4, discrete
    *(f"model.opt.iterations = {value}" for value in (0, 1, 3, 500)),
    *(f"model.opt.ls_iterations = {value}" for value in (0, 1)),
    *(f"model.opt.noslip_iterations = {value}" for value in (0, 3)),
    *(f"model.opt.impratio = {value}" for value in (0.01, 1, 100)),
    *(f"model.opt.density = {value}" for value in (0, 1000)),
    *(f"model.opt.viscosity = {value}" for value in (0, 1, 1e6)), "model.opt.wind = [3, -20, 5]",
    "model.opt.gravity = [0, 0, 0]", "model.opt.gravity = [4, 5, 6]",
    "model.opt.gravity = [0, 0, -1e5]",
    *(f"model.opt.disableflags ^= 1 << {bit}" for bit in range(FLAGS)),
    *(f"model.opt.enableflags ^= 1 << {bit}" for bit in range(ENABLES)),
)  # fmt: skip
"""All legal, not all without effect."""

BAD_OPTIONS = (
    *(f"model.opt.timestep = {value}" for value in ("0", "-1e-3", "np.nan", "np.inf", "1e-30")),
    *(f"model.opt.timestep = {value}" for value in ("1.0", "1e10", "1e-9")),
    "model.opt.gravity = [0, np.nan, -9.81]", "model.opt.gravity = [np.inf, 0, 0]",
    "model.opt.tolerance = np.nan", "model.opt.impratio = np.nan", "model.opt.impratio = 0",
    "model.opt.density = np.nan", "model.opt.viscosity = np.inf", "model.opt.integrator = 77",
    "model.opt.solver = -3", "model.opt.jacobian = 9",
)  # fmt: skip
"""Numbers that no option should have."""

FIELDS = (
    *(f"model.dof_damping = {value}" for value in (0, 0.01, 1, 100)),
    *(f"model.dof_armature = {value}" for value in (0, 0.1)),
    *(f"model.dof_frictionloss = {value}" for value in (0, 0.5)),
    *(f"model.jnt_stiffness = {value}" for value in (0, 30)), "model.body_mass *= 3",
    "model.body_inertia *= 0.2",
    "model.body_ipos += random.normal(scale=0.05, size=model.body_ipos.shape)",
    "model.geom_size *= 2", "model.geom_pos += 0.02", "model.geom_friction *= 0.1",
    "model.hfield_data = random.uniform(size=model.hfield_data.size)", "model.hfield_data = 0",
    "model.eq_data *= 0.5", "model.tendon_damping = 1", "model.tendon_stiffness = 20",
    "model.actuator_gainprm *= -1", "model.actuator_biasprm *= 5",
)  # fmt: skip
"""Changes of the model that are legal while it runs."""

BAD_FIELDS = (
    "model.hfield_data = np.nan", "model.hfield_data[::3] = np.inf", "model.hfield_data = -1e30",
    "model.body_mass = 0", "model.body_mass *= -1", "model.body_mass *= 1e12",
    "model.body_inertia = 0", "model.dof_damping = np.nan", "model.dof_damping = -100",
    "model.dof_armature = -1e3", "model.body_pos[1:] = np.nan", "model.body_ipos[1:] = np.inf",
    "model.geom_size = 0", "model.geom_size = -1", "model.geom_size = np.nan",
    "model.jnt_stiffness = 1e12", "model.actuator_gainprm = np.nan",
)  # fmt: skip
"""Changes that no model should have."""

BAD_STATES = (
    *(f"data.ctrl = {value}" for value in ("np.nan", "np.inf", "1e10", "-1e300")),
    *(f"data.act = {value}" for value in ("np.nan", "1e200")),
    *(f"data.qvel[{where}] = {value}" for where in ("0", ":") for value in ("np.nan", "np.inf")),
    *(f"data.qvel *= {value}" for value in ("1e3", "1e8", "1e150", "1e308")),
    *(f"data.qvel = {value}" for value in ("1e4", "1e9", "-1e200")),
    *(f"data.qpos[{where}] = {value}" for where in ("0", ":", "-1") for value in ("np.nan", "1e9")),
    "data.qpos = np.inf", "data.qpos[2] = -1e5", "data.qpos = 0", "data.qacc_warmstart = np.nan",
    "data.qacc_warmstart = 1e300",
    *(f"data.xfrc_applied = {value}" for value in ("np.nan", "1e12", "-np.inf")),
    *(f"data.xfrc_applied[-1] = {value}" for value in ("np.nan", "1e300")),
    *(f"data.qfrc_applied = {value}" for value in ("np.nan", "1e9", "1e300")),
    *(f"data.mocap_pos = {value}" for value in ("np.nan", "np.inf", "1e300", "1e6")),
    *(f"data.mocap_quat = {value}" for value in ("np.nan", "0", "1e200")),
    *(f"data.time = {value}" for value in ("np.nan", "1e300")),
)  # fmt: skip
"""Bad or extreme states and controls."""

_MASS = "mujoco.mj_mulM(model, data, data.qfrc_applied"
PUSHES = (
    ("data.ctrl = random.normal(scale=2, size=model.nu)", 0.5),
    ("data.qfrc_applied = random.normal(scale=0.5, size=model.nv)", 0.1),
    ("data.xfrc_applied = random.normal(scale=0.5, size=(model.nbody, 6))", 0.1),
    # An impact, a brake stronger than the sand, a withdrawal.
    (f"{_MASS}, random.normal(scale=20, size=model.nv) / 0.02)", 0.1),
    (f"{_MASS}, -data.qvel / 0.005)", 0.1),
    ("data.xfrc_applied[:, 2] = 20 * model.body_mass / 0.1", 0.05),
    ("data.qfrc_applied = 0", 0.1),
    ("data.mocap_pos += random.normal(scale=0.01, size=data.mocap_pos.shape)", 0.3),
    ("data.eq_active = random.integers(0, 2, model.neq)", 0.1),
    ("report", 0.05),
)
"""Controls, external forces, a moving mocap body, a switched equality, with their probabilities."""

KINDS = {"plain": 0.4, "options": 0.3, "hostile": 0.2, "rest": 0.1}
"""Only controls; legal changes in motion; illegal ones too; changes at rest. With their shares."""

RESTING = ("link_distributed", "rft2d", "rft3d", *models.MOVING)
"""Laws under which everything comes to rest."""


def draw(seed: int, number: int, options: Namespace) -> ModelCase:
    """Draw a model, its sand, and what happens to it."""
    rng = np.random.default_rng([seed, number])
    programs = models.SHORT if options.short else models.PROGRAMS
    programs = [each for each in programs if not options.laws or each[0] in options.laws]
    chosen = str(rng.choice(list(KINDS), p=list(KINDS.values())))
    program = programs[int(rng.integers(len(programs)))]
    kind, steps = options.kind or chosen, options.steps
    if kind != "rest":
        case = models.draw(rng, program, number)
        case.events = list(_events(rng, kind, steps))
    else:
        still = [p for p in programs if p[0] in RESTING and p[1:] == ("plane", "implicit")]
        still = still or [("link_distributed", "plane", "implicit")]
        case = models.draw_at_rest(rng, still[int(rng.integers(len(still)))], number)
        case.settled = settled = (3 * steps) // 4
        at = rng.integers(settled, steps, 3)
        case.events = [(int(step), str(rng.choice(OPTIONS))) for step in at]
    case.events.sort(key=lambda event: event[0])
    case.kind, case.steps = kind, steps
    return case


def _events(rng: np.random.Generator, kind: str, steps: int) -> Iterator[tuple[int, str]]:
    """Draw the events of a body in motion, which starts away from the pose of the model."""
    speed = rng.choice([0, 0.1, 1, 1, 5, 30])
    yield 0, seeded(rng, f"data.qvel = random.normal(scale={speed}, size=model.nv)")
    if rng.random() < 0.6:
        turned = "random.normal(scale=0.2, size=model.nv)"
        yield 0, seeded(rng, f"mujoco.mj_integratePos(model, data.qpos, {turned}, 1)")
    for step in range(0, steps, 8):
        for line, chance in PUSHES:
            if rng.random() < chance:
                yield step, seeded(rng, line)
    if kind == "plain":
        return
    lines: tuple[str, ...] = OPTIONS + OPTIONS + RARE_OPTIONS + FIELDS
    for step in rng.integers(1, steps, rng.integers(2, 9)):
        yield int(step), seeded(rng, str(rng.choice(lines)))
    if kind == "hostile":
        lines = BAD_OPTIONS + BAD_FIELDS + BAD_STATES + BAD_STATES
        for step in rng.integers(1, steps, rng.integers(1, 5)):
            yield int(step), str(rng.choice(lines))


def seeded(rng: np.random.Generator, line: str) -> str:
    """Return the line with a seeded generator in place of `random`."""
    return line.replace("random.", f"np.random.default_rng({rng.integers(1 << 31)}).")


def run(line: str, model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Run an event, unless the model lacks what it needs."""
    with suppress(IndexError, ValueError, TypeError):
        exec(line, {"model": model, "data": data, "mujoco": mujoco, "np": np})
