"""Simulation of a measured run with a law."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np

from mjgranular.law import Law
from mjgranular.medium import Medium, get_medium
from mjgranular.models import Projectile
from mjgranular.models.link import offset
from mjgranular.referee.motion import Motion
from mjgranular.referee.runs import MeasuredRun, load_machine
from mjgranular.sand import Sand
from mjgranular.sand.material import law_of
from mjgranular.scheme import Explicit

TIMESTEP = 5e-5
"""Time step of simulated drops [s]: halving it changes final depths by less than 0.3 %."""

_SAMPLES = 1e-4  # time between two samples [s]
_HEAVY = 1e6  # inertia of a body that keeps its angle [kg m^2]; chosen
_HEAVY_BODY = 1e4  # mass or inertia of a body that keeps its speed [kg, kg m^2]; chosen
_SETTLES = 0.01  # sinking speed of a wheel of given sinkage, in parts of its speed; chosen
_ROLLED, _ROLL_STEP = 0.2, 1e-2  # path [m] and step [s]; halving either changes 3 % at most
_WALK_STEP, _CYCLES = 1e-3, 2  # [s]; turns to become steady, and then to average


def simulate(
    run: MeasuredRun,
    medium: Medium | str,
    law: Law | str | None = None,
    *,
    timestep: float = TIMESTEP,
    scheme: str = "implicit",
    longer: float = 0.1,
) -> Motion:
    """Simulate a measured run with a law.

    A drop starts with the depth and speed of the run's first row and ends with its last, or where
    the body stops after that; a push or drag takes the depth and speed of each row in turn, and the
    other kinds the values of each row.

    Args:
        run: the run.
        medium: the sand.
        law: its law; None for the medium's default.
        timestep: time step of a drop [s].
        scheme: time stepping scheme of a drop.
        longer: time after the end of the run within which the body may stop [s].

    Raises:
        InputError: the law has no elements for such a body.
        UnknownNameError: no such law or medium.
    """
    if run.kind == "drop":
        return _drop(run, medium, law, timestep=timestep, scheme=scheme, longer=longer)
    if isinstance(run.body, Path):
        return {"sink": _sunk, "walk": _walked}.get(run.kind, _led)(run, medium, law)
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
    assert isinstance(run.body, Projectile)
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
    rows = [(0.0, *_seen(run.body, data))]
    fastest = run.speed
    for step in range(1, math.ceil((last + longer) / timestep) + 1):
        sand.step(data)
        if step % every == 0:
            rows.append((step * timestep, *_seen(run.body, data)))
            fastest = max(fastest, rows[-1][2])
            if step * timestep > last and rows[-1][2] < 0.005 * fastest:
                break
    found = np.array(rows)
    if run.to_the_stop:
        found = found[: int(np.argmax(found[:, 1])) + 1]
    t, deepest, speed, pitch = found.T
    # Mean force since the previous row, from momentum.
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


def _seen(body: Projectile, data: mujoco.MjData) -> tuple[float, float, float]:
    """Return lowest depth [m], downward speed of C [m/s], angle from vertical [degrees]."""
    q = float(data.qpos[2])
    _, below = offset(body.lowest(q), q)
    return -(float(data.qpos[1]) + below), -float(data.qvel[1]), abs(math.degrees(q))


def _pushed(
    run: MeasuredRun, medium: Medium | str, law: Law | str | None, *, timestep: float
) -> Motion:
    """Simulate a push at constant speed, with the sand's inertia: mean forces between rows.

    The body is heavy and is put back on its path after each step; the force is the momentum that
    the sand took from it.
    """
    assert isinstance(run.body, Projectile)
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
    assert isinstance(run.body, Projectile)
    model = run.body.model(TIMESTEP)
    sand = Sand(model, medium=medium, law=law, bodies="link", scheme=Explicit(prescribed=True))
    data = mujoco.MjData(model)
    speeds = run.motion.speed
    if speeds is None:
        speeds = np.full(len(run.motion.depth), run.speed)
    q = math.radians(run.angle)
    place, along = run.body.touching(q), run.kind == "drag"
    force, lift = [], []
    for depth, speed in zip(run.motion.depth, speeds, strict=True):
        data.qpos[:] = place
        data.qpos[1] -= depth
        data.qvel[:] = (speed, 0.0, 0.0) if along else (0.0, -speed, 0.0)
        (body,) = sand.report(data).bodies
        force.append(-body.force[0] if along else body.force[2])
        lift.append(body.force[2])
    return Motion(
        depth=run.motion.depth,
        speed=speeds,
        force=np.array(force),
        lift=np.array(lift) if along else None,
    )


def _led(run: MeasuredRun, medium: Medium | str, law: Law | str | None) -> Motion:
    """Return the law's forces on a body from an MJCF file at the pose and velocity of each row."""
    assert isinstance(run.body, Path)
    model = load_machine(run.body).compile()
    sand = Sand(model, medium=medium, law=law, scheme=Explicit(prescribed=True))
    data = mujoco.MjData(model)
    force = np.zeros((len(run.motion.depth), 3))
    for i, row in enumerate(_rows(run)):
        data.qpos[:], data.qvel[:] = model.qpos0, 0.0
        if run.kind == "turn":
            data.joint("turn").qpos, data.joint("turn").qvel = row["angle"], run.speed
        else:
            data.joint("z").qpos = -row["depth"]
            for name, value in _velocity(row).items():
                data.joint(name).qvel = value
        if run.kind == "roll":
            data.joint("z").qvel = -_SETTLES * row["speed"]
        (body,) = sand.report(data).bodies
        force[i] = body.force
    sign = 1 if run.kind == "turn" else -1
    return replace(
        run.motion,
        force=sign * force[:, 0],
        side=None if run.motion.side is None else -force[:, 1],
        lift=force[:, 2],
    )


def _sunk(run: MeasuredRun, medium: Medium | str, law: Law | str | None) -> Motion:
    """Simulate a driven wheel under its load: final depth, and mean forces before.

    It is heavy in the prescribed directions, and is put back to its speed after each step; the
    force is the momentum that the sand took from it.
    """
    assert isinstance(run.body, Path)
    spec = load_machine(run.body)
    spec.option.timestep = _ROLL_STEP
    for name in ("x", "y", "turn"):
        spec.joint(name).armature = _HEAVY_BODY
    model = spec.compile()
    sand = Sand(model, medium=medium, law=law, scheme="implicit")
    data = mujoco.MjData(model)
    x, y, z = (_dof(model, name) for name in "xyz")
    weight = -float(model.body_subtreemass[0] * model.opt.gravity[2])
    depth, force = np.zeros(len(run.motion.depth)), np.zeros((len(run.motion.depth), 2))
    for i, row in enumerate(_rows(run)):
        mujoco.mj_resetData(model, data)
        data.qfrc_applied[z] = weight - row["lift"]
        velocity = _velocity(row)
        lost = np.zeros((round(_ROLLED / row["speed"] / _ROLL_STEP), 2))
        for step in range(len(lost)):
            for name, value in velocity.items():
                data.qvel[_dof(model, name)] = value
            sand.step(data)
            lost[step] = velocity["x"] - data.qvel[x], velocity["y"] - data.qvel[y]
        force[i] = _HEAVY_BODY * lost[-len(lost) // 5 :].mean(axis=0) / _ROLL_STEP
        depth[i] = -data.joint("z").qpos[0]
    return replace(run.motion, depth=depth, force=force[:, 0], side=force[:, 1])


def _walked(run: MeasuredRun, medium: Medium | str, law: Law | str | None) -> Motion:
    """Simulate a robot with legs at a constant rate: mean speed along x over full turns."""
    assert isinstance(run.body, Path)
    spec = load_machine(run.body)
    spec.option.timestep = _WALK_STEP
    legs = [j for j in spec.joints if j.type == mujoco.mjtJoint.mjJNT_HINGE and j.name != "pitch"]
    for leg in legs:
        leg.armature = _HEAVY_BODY
    model = spec.compile()
    turning = [int(model.jnt_dofadr[leg.id]) for leg in legs]
    sand = Sand(model, medium=medium, law=law)
    data = mujoco.MjData(model)
    rates, speeds = run.motion.rate, []
    assert rates is not None
    for rate in rates:
        mujoco.mj_resetDataKeyframe(model, data, 0)
        data.qvel[turning] = 2 * math.pi * rate
        turns, passed = round(_CYCLES / rate / _WALK_STEP), []
        for _ in range(2):
            for _ in range(turns):
                sand.step(data)
            passed.append(float(data.joint("x").qpos[0]))
        speeds.append((passed[1] - passed[0]) / (turns * _WALK_STEP))
    return replace(run.motion, speed=np.array(speeds))


def _dof(model: mujoco.MjModel, name: str) -> int:
    return int(model.joint(name).dofadr[0])


def _rows(run: MeasuredRun) -> list[dict[str, float]]:
    """Return the values of each row, angles in radians; the run's speed if rows have none."""
    columns = {name: value for name, value in vars(run.motion).items() if np.ndim(value) == 1}
    columns.setdefault("speed", np.full(len(run.motion.depth), run.speed))
    rows = [
        dict(zip(columns, map(float, row), strict=True))
        for row in zip(*columns.values(), strict=True)
    ]
    return [row | {"angle": math.radians(row.get("angle", 0.0))} for row in rows]


def _velocity(row: dict[str, float]) -> dict[str, float]:
    """Return the joint velocities of a body with prescribed motion."""
    along = {"x": row["speed"] * math.cos(row["angle"])}
    if "spin" not in row:
        return along
    return along | {"y": row["speed"] * math.sin(row["angle"]), "turn": row["spin"]}
