"""A measured run once more, under a law."""

from __future__ import annotations

import math
from itertools import pairwise

import mujoco
import numpy as np

from mjgranular.law import Law
from mjgranular.medium import Medium, get_medium
from mjgranular.models.link import offset
from mjgranular.referee.motion import Motion
from mjgranular.referee.runs import MeasuredRun
from mjgranular.sand import Sand
from mjgranular.sand.material import law_of
from mjgranular.scheme import Explicit

TIMESTEP = 5e-5
"""Of simulated drops [s]: halving it moves final depths by less than 0.3 %."""

_SAMPLES = 1e-4  # between two samples [s]
_HEAVY = 1e6  # inertia of a body that keeps its angle [kg m^2]; chosen
_HEAVY_BODY = 1e4  # mass of a body that keeps its speed [kg]; chosen


def simulate(
    run: MeasuredRun,
    medium: Medium | str,
    law: Law | str | None = None,
    *,
    timestep: float = TIMESTEP,
    scheme: str = "implicit",
    longer: float = 0.1,
) -> Motion:
    """Does what was done in a run, under a law.

    A drop begins with the depth and speed of the run's first row and ends with its last, or where
    the body stops after that; a push or drag is at the depth and speed of each row in turn.

    Args:
        run: the run.
        medium: the sand.
        law: its law; None for the medium's own.
        timestep: of a drop [s].
        scheme: of a drop.
        longer: how long after the end of the run the body may take to stop [s].

    Raises:
        InputError: the law has no elements for such a body.
        UnknownNameError: no such law or medium.
    """
    if run.kind == "drop":
        return _drop(run, medium, law, timestep=timestep, scheme=scheme, longer=longer)
    if run.kind == "intrude" and law_of(law, get_medium(medium)).adds_mass:
        return _pushed(run, medium, law, timestep=timestep)
    return _moved(run, medium, law)


def _drop(
    run: MeasuredRun,
    medium: Medium | str,
    law: Law | str | None,
    *,
    timestep: float,
    scheme: str,
    longer: float,
) -> Motion:
    time, depth = run.motion.time, run.motion.depth
    assert time is not None
    spec = run.body.spec()
    if run.guided:
        for joint in spec.joints:
            if joint.type == mujoco.mjtJoint.mjJNT_HINGE:
                joint.armature = _HEAVY
    spec.option.timestep = timestep
    model = spec.compile()
    sand = Sand(model, medium=medium, law=law, bodies="link", scheme=scheme)
    data = mujoco.MjData(model)
    q = math.radians(run.angle)
    data.qpos[:] = run.body.touching(q)
    data.qpos[1] -= depth[0]
    data.qvel[:] = run.body.moving(q, run.speed, 0.0, 0.0)
    gravity = float(np.linalg.norm(model.opt.gravity))

    every = max(1, round(_SAMPLES / timestep))
    last = time[-1] - time[0]
    rows = [(0.0, *_seen(run, data))]
    fastest = run.speed
    for step in range(1, math.ceil((last + longer) / timestep) + 1):
        sand.step(data)
        if step % every == 0:
            rows.append((step * timestep, *_seen(run, data)))
            fastest = max(fastest, rows[-1][2])
            if step * timestep > last and rows[-1][2] < 0.005 * fastest:
                break
    found = np.array(rows)
    if run.to_the_stop:
        found = found[: int(np.argmax(found[:, 1])) + 1]
    t, deepest, speed, pitch = found.T
    # Mean force since the row before, from momentum.
    force = np.zeros(len(t))
    force[1:] = run.body.mass * (gravity - np.diff(speed) / np.diff(t))
    return Motion(
        depth=deepest,
        time=t + time[0],
        speed=speed,
        force=force,
        pitch=None if run.body.shape == "sphere" else pitch,
        to_the_stop=run.to_the_stop,
    )


def _seen(run: MeasuredRun, data: mujoco.MjData) -> tuple[float, float, float]:
    """Depth of the lowest point [m], speed of C down [m/s], angle from the vertical [degrees]."""
    q = float(data.qpos[2])
    _, below = offset(run.body.lowest(q), q)
    return -(float(data.qpos[1]) + below), -float(data.qvel[1]), abs(math.degrees(q))


def _pushed(
    run: MeasuredRun, medium: Medium | str, law: Law | str | None, *, timestep: float
) -> Motion:
    """A push at constant speed in which sand is set in motion: mean forces since the row before.

    The body is heavy and is put back on its way after each step; what the sand has taken of its
    momentum is the force.
    """
    spec = run.body.spec()
    spec.body("link").mass = _HEAVY_BODY
    spec.option.timestep = timestep
    model = spec.compile()
    sand = Sand(model, medium=medium, law=law, bodies="link", scheme="implicit")
    data = mujoco.MjData(model)
    gravity = -float(model.opt.gravity[2])
    place = run.body.touching(math.radians(run.angle))

    def force_at(depth: float) -> float:
        data.qpos[:], data.qvel[:], data.qacc_warmstart[:] = place, (0.0, -run.speed, 0.0), 0.0
        data.qpos[1] -= depth
        sand.step(data)
        return _HEAVY_BODY * ((data.qvel[1] + run.speed) / timestep + gravity)

    depths = run.motion.depth
    force = [force_at(depths[0])]
    for before, depth in pairwise(depths):
        count = max(1, round(abs(depth - before) / (run.speed * timestep)))
        way = before + (depth - before) * (np.arange(count) + 0.5) / count
        force.append(float(np.mean([force_at(at) for at in way])))
    return Motion(depth=depths, speed=np.full(len(depths), run.speed), force=np.array(force))


def _moved(run: MeasuredRun, medium: Medium | str, law: Law | str | None) -> Motion:
    model = run.body.model(TIMESTEP)
    sand = Sand(model, medium=medium, law=law, bodies="link", scheme=Explicit(prescribed=True))
    data = mujoco.MjData(model)
    speeds = run.motion.speed
    if speeds is None:
        speeds = np.full(len(run.motion.depth), run.speed)
    q = math.radians(run.angle)
    place, along = run.body.touching(q), run.kind == "drag"
    force = []
    for depth, speed in zip(run.motion.depth, speeds, strict=True):
        data.qpos[:] = place
        data.qpos[1] -= depth
        data.qvel[:] = (speed, 0.0, 0.0) if along else (0.0, -speed, 0.0)
        (body,) = sand.report(data).bodies
        force.append(-body.force[0] if along else body.force[2])
    return Motion(depth=run.motion.depth, speed=speeds, force=np.array(force))
