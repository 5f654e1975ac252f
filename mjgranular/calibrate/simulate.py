"""Simulation of a measured run with a law."""

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np

from mjgranular.calibrate.material import Material
from mjgranular.calibrate.motion import Motion
from mjgranular.calibrate.runs import Run, load_machine
from mjgranular.errors import GranularWarning, UnstableError
from mjgranular.kernel.compiled import entry
from mjgranular.law import Law
from mjgranular.medium import Medium, get_medium
from mjgranular.models import Projectile
from mjgranular.sand.binding import Binding, bind, finish_step, guarded_step
from mjgranular.sand.prepare import PreparedSand, prepare
from mjgranular.sand.spec import SandSpec
from mjgranular.scheme import Explicit, Scheme
from mjgranular.scheme.scheme import FINE

TIMESTEP = 5e-5
"""Time step of simulated drops [s]: halving it changes final depths by less than 0.3 %."""

_SAMPLES = 1e-4  # time between two samples [s]
_LONGER = 0.1  # time after the end of the run within which the body may stop [s]
_HEAVY = 1e6  # inertia of a body that keeps its angle [kg m^2]; chosen
_PUSHED = 1e12  # mass or inertia of a body that is pushed [kg, kg m^2]; chosen
_MOST_STEPS = 1000  # of a push between two rows; chosen
_HEAVY_BODY = 1e4  # mass or inertia of a body that keeps its speed [kg, kg m^2]; chosen
_SETTLES = 0.01  # sinking speed of a wheel of given sinkage, in parts of its speed; chosen
_ROLLED, _ROLL_STEP = 0.2, 1e-2  # path [m] and step [s]; halving either changes 3 % at most
_WALK_STEP, _CYCLES = 1e-3, 2  # [s]; turns to become steady, and then to average


class Simulator:
    """A model on sand whose law can change between runs, without recompiling.

    A law's constants are numbers in the record that its compiled program reads. If a change of
    constants changes neither elements nor kernels, which is checked once for each set of constants,
    a new law is a new record and costs nothing; else `use` replaces `data`. The time step may
    change too. The scheme is for free motion, or for forces on a prescribed motion.
    """

    def __init__(self, model: mujoco.MjModel, scheme: Scheme | str) -> None:
        self.model, self._scheme = model, scheme
        self.data = mujoco.MjData(model)
        self._guarded = entry(guarded_step, "int64(int64, int64, float64)")
        self._finish = entry(finish_step, "int64(int64)")
        self._prepared: PreparedSand
        self._binding: Binding
        self._material: Material | None = None  # of the binding
        self._harmless: set[frozenset[str]] = set()  # constants that elements do not depend on

    def use(self, material: Material) -> None:
        law, medium, changed = material.law, material.medium, self._changed(material)
        if changed is None or changed not in self._harmless:
            spec = SandSpec(medium=medium, law=law, scheme=self._scheme)
            with warnings.catch_warnings():  # the model is made for this; the law is still unknown
                warnings.simplefilter("ignore", GranularWarning)
                prepared = prepare(self.model, spec)
            if changed is None or not np.array_equal(prepared.elements, self._prepared.elements):
                self.data = mujoco.MjData(self.model)  # the old sand has addresses in the last one
                self._prepared, self._material = prepared, material
                self._binding = bind(self.model, self.data, prepared)
                self._harmless.clear()
            else:
                self._harmless.add(changed)
        self._prepared.scene["law"][:] = law.parameters(medium)

    def _changed(self, material: Material) -> frozenset[str] | None:
        """Return the constants that differ from those of the bound sand; None for other kernels."""
        if self._material is None:
            return None
        before, after = self._material.law, material.law
        if type(before) is not type(after) or (
            after.kernel(self._prepared.surface) is not self._prepared.kernel
        ):
            return None
        every = fields(before)  # pyright: ignore[reportArgumentType]
        names = {f.name for f in every if getattr(before, f.name) != getattr(after, f.name)}
        if self._material.medium != material.medium:
            names.add("medium")
        return frozenset(names)

    def depths_of(self, body: int) -> np.ndarray:
        """Return the depth of each element of a body at the last force [m]."""
        return self._binding.contacts["depth"][self._prepared.elements["body"] == body]

    def _check(self, status: int) -> None:
        if status != FINE:
            time, law = self.data.time, self._prepared.law
            raise UnstableError(f"the simulation diverged at t = {time:.4g} s with {law}")

    def _act(self, lead: float) -> None:
        self._check(self._guarded(self._prepared.program, self._binding.address, lead))

    def step(self) -> None:
        mujoco.mj_step1(self.model, self.data)
        self._act(self._prepared.scheme.lead * self.model.opt.timestep)
        mujoco.mj_step2(self.model, self.data)
        self._check(self._finish(self._binding.address))

    def reset(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = qpos, qvel

    def force(self) -> np.ndarray:
        """Return the sand's force on the model at the state in `data` [N], world, shape (3,)."""
        model, data = self.model, self.data
        data.xfrc_applied[:] = 0.0
        self._binding.bodies["last_wrench"] = np.nan
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        self._act(self._prepared.scheme.lead * model.opt.timestep)
        total = data.xfrc_applied[:, :3].sum(axis=0)
        data.xfrc_applied[:] = 0.0
        return total


def simulate(
    run: Run, medium: Medium | str, law: Law | str | None = None, *, timestep: float = TIMESTEP
) -> Motion:
    """Simulate a measured run with a law.

    A drop starts with the depth and speed of the run's first row and ends with its last, or where
    the body stops after that; a push or drag takes the depth and speed of each row in turn, and the
    other kinds the values of each row. The time step is that of a drop [s].

    Raises:
        InputError: the law has no elements for the body, or the run is of a model or begins in air.
        UnknownNameError: no such law or medium.
    """
    if run.kind == "model":
        raise run.error("a run of a model can only be fitted")
    run.check_start()
    return simulate_with(run, Material.of(get_medium(medium), law), {}, timestep=timestep)


def simulate_with(
    run: Run,
    material: Material,
    simulators: dict[str, Simulator],
    way: str | None = None,
    *,
    timestep: float = TIMESTEP,
) -> Motion:
    """Simulate a run in one of the ways of `_MOVES`; None for that of its kind.

    Its simulator is one of those of the run, to which a missing one is added.
    """
    if way is None and run.kind == "intrude" and material.law.adds_mass:
        way = "push"
    way = way or (run.kind if run.kind in _MOVES else "place")
    if way not in simulators:
        simulators[way] = _simulator_of(run, way, timestep)
    simulators[way].use(material)
    return _MOVES[way](run, simulators[way])


def _simulator_of(run: Run, way: str, timestep: float) -> Simulator:
    spec = load_machine(run.body) if isinstance(run.body, Path) else run.body.spec()
    hinges = [joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_HINGE]
    legs = [joint for joint in hinges if joint.name != "pitch"]
    driven = [joint for joint in spec.joints if joint.name in ("x", "y", "turn")]
    # The scheme, the time step, and joints that keep their speed, with their inertia.
    ways: dict[str, tuple[Scheme | str, float, Sequence[mujoco.MjsJoint], float]] = {
        "drop": ("implicit", timestep, hinges if run.guided else (), _HEAVY),
        "push": ("implicit", timestep, spec.joints, _PUSHED),
        "press": ("implicit", timestep, spec.joints, _PUSHED),
        "sink": ("implicit", _ROLL_STEP, driven, _HEAVY_BODY),
        "walk": ("auto", _WALK_STEP, legs, _HEAVY_BODY),
        "place": (Explicit(prescribed=True), spec.option.timestep, (), 0.0),
    }
    scheme, spec.option.timestep, joints, inertia = ways[way]
    for joint in joints:
        joint.armature = inertia
    return Simulator(spec.compile(), scheme)


def _drop(run: Run, simulator: Simulator) -> Motion:
    time, depth = run.motion.time, run.motion.depth
    body, q = run.body, run.angle
    assert time is not None
    assert isinstance(body, Projectile)
    start = body.touching(q)
    start[1] -= depth[0]
    simulator.reset(start, body.moving(q, run.speed, 0.0, 0.0))
    gravity = float(np.linalg.norm(simulator.model.opt.gravity))
    timestep = simulator.model.opt.timestep
    every = max(1, round(_SAMPLES / timestep))
    last = time[-1] - time[0]
    rows, fastest, data = [], run.speed, simulator.data
    for step in range(math.ceil((last + _LONGER) / timestep) + 1):
        if step > 0:
            simulator.step()
        if step % every == 0:
            deepest, speed = lowest_depth(body, data.qpos), -float(data.qvel[1])
            rows.append((step * timestep, deepest, speed, abs(math.degrees(data.qpos[2]))))
            fastest = max(fastest, speed)
            if step * timestep > last and speed < 0.005 * fastest:
                break
    found = np.array(rows)
    if run.motion.to_the_stop:
        found = found[: int(np.argmax(found[:, 1])) + 1]
    t, deepest, speed, pitch = found.T
    # Mean force since the previous row, from momentum.
    force = np.zeros(len(t))
    force[1:] = body.mass * (gravity - np.diff(speed) / np.diff(t))
    return Motion(
        depth=deepest,
        time=t + time[0],
        speed=speed,
        force=force,
        pitch=None if body.shape == "sphere" else pitch,
        to_the_stop=run.motion.to_the_stop,
    )


def lowest_depth(body: Projectile, qpos: np.ndarray) -> float:
    """Return the depth of the lowest point of a projectile [m]."""
    return float(body.touching(float(qpos[2]))[1] - qpos[1])


def _forces_of_push(run: Run, simulator: Simulator, depths: np.ndarray) -> np.ndarray:
    """Return the forces on a body pushed at constant speed, with the sand's inertia, at depths [N].

    The body is so heavy that it keeps its speed.
    """
    assert isinstance(run.body, Projectile)
    place, forces = run.body.touching(run.angle), []
    for depth in depths:
        simulator.reset(place, np.array([0.0, -run.speed, 0.0]))
        simulator.data.qpos[1] -= depth
        forces.append(simulator.force()[2])
    return np.array(forces)


def _push(run: Run, simulator: Simulator) -> Motion:
    """Push at constant speed: mean forces between rows."""
    depths, step = run.motion.depth, run.speed * simulator.model.opt.timestep
    force = [_forces_of_push(run, simulator, depths[:1])[0]]
    for before, depth in pairwise(depths):
        count = round(np.clip(abs(depth - before) / step, 1, _MOST_STEPS))
        way = before + (depth - before) * (np.arange(count) + 0.5) / count
        force.append(_forces_of_push(run, simulator, way).mean())
    return Motion(depth=depths, speed=np.full(len(depths), run.speed), force=np.array(force))


def _press(run: Run, simulator: Simulator) -> Motion:
    """Push at constant speed: forces at the rows."""
    return replace(run.motion, force=_forces_of_push(run, simulator, run.motion.depth))


def _place(run: Run, simulator: Simulator) -> Motion:
    """Return the forces on a body at the pose and velocity of each row."""
    model, data, rows = simulator.model, simulator.data, _rows(run)
    pose = model.qpos0 if isinstance(run.body, Path) else run.body.touching(run.angle)
    forces = []
    for row in rows:
        data.qpos[:], data.qvel[:] = pose, 0.0
        if run.kind == "turn":
            data.joint("turn").qpos = row["angle"]
        else:
            data.joint("z").qpos[0] -= row["depth"]
        for name, value in _velocity(run.kind, row).items():
            data.joint(name).qvel = value
        forces.append(simulator.force())
    x, y, z = np.array(forces).T
    if run.kind == "intrude":
        speed = np.array([row["speed"] for row in rows])
        return Motion(depth=run.motion.depth, speed=speed, force=z)
    side = None if run.motion.side is None else -y
    return replace(run.motion, force=x if run.kind == "turn" else -x, side=side, lift=z)


def _sink(run: Run, simulator: Simulator) -> Motion:
    """Drive a wheel under its load: final depth, and mean forces before.

    It is heavy in the prescribed directions, and is put back to its speed after each step; the
    force is the momentum that the sand took from it.
    """
    model, data = simulator.model, simulator.data
    address = {name: int(model.joint(name).dofadr[0]) for name in ("x", "y", "z", "turn")}
    weight = -float(model.body_subtreemass[0] * model.opt.gravity[2])
    depth, force = np.zeros(len(run.motion.depth)), np.zeros((len(run.motion.depth), 2))
    for i, row in enumerate(_rows(run)):
        mujoco.mj_resetData(model, data)
        data.qfrc_applied[address["z"]] = weight - row["lift"]
        velocity = _velocity(run.kind, row)
        lost = np.zeros((round(_ROLLED / row["speed"] / _ROLL_STEP), 2))
        for step in range(len(lost)):
            for name, value in velocity.items():
                data.qvel[address[name]] = value
            simulator.step()
            lost[step] = [velocity[name] - data.qvel[address[name]] for name in "xy"]
        force[i] = _HEAVY_BODY * lost[-len(lost) // 5 :].mean(axis=0) / _ROLL_STEP
        depth[i] = -data.joint("z").qpos[0]
    return replace(run.motion, depth=depth, force=force[:, 0], side=force[:, 1])


def _walk(run: Run, simulator: Simulator) -> Motion:
    """Walk with legs at a constant rate: mean speed along x over full turns."""
    model, data = simulator.model, simulator.data
    hinges = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE)
    legs = [int(model.jnt_dofadr[k]) for k in hinges if model.joint(k).name != "pitch"]
    rates, speeds = run.motion.rate, []
    assert rates is not None
    for rate in rates:
        mujoco.mj_resetDataKeyframe(model, data, 0)
        data.qvel[legs] = 2 * math.pi * rate
        turns, passed = round(_CYCLES / rate / _WALK_STEP), []
        for _ in range(2):
            for _ in range(turns):
                simulator.step()
            passed.append(float(data.joint("x").qpos[0]))
        speeds.append((passed[1] - passed[0]) / (turns * _WALK_STEP))
    return replace(run.motion, speed=np.array(speeds))


_MOVES: dict[str, Callable[[Run, Simulator], Motion]] = {
    "drop": _drop,
    "push": _push,
    "press": _press,
    "place": _place,
    "sink": _sink,
    "walk": _walk,
}
"""How runs are simulated."""


def _rows(run: Run) -> list[dict[str, float]]:
    """Return the values of each row, angles in radians; the run's speed if rows have none."""
    same = np.ones(len(run.motion.depth))
    given = {name: value for name, value in vars(run.motion).items() if np.ndim(value) == 1}
    columns = {"speed": run.speed * same, "angle": 0.0 * same} | given
    columns["angle"] = np.radians(columns["angle"])
    rows = zip(*columns.values(), strict=True)
    return [dict(zip(columns, map(float, row), strict=True)) for row in rows]


def _velocity(kind: str, row: dict[str, float]) -> dict[str, float]:
    """Return the joint velocities of a body with prescribed motion."""
    if kind in ("turn", "intrude"):
        return {"turn": row["speed"]} if kind == "turn" else {"z": -row["speed"]}
    found = {"x": row["speed"] * math.cos(row["angle"])}
    if "spin" in row:
        found |= {"y": row["speed"] * math.sin(row["angle"]), "turn": row["spin"]}
    if kind == "roll":
        found["z"] = -_SETTLES * row["speed"]
    return found
