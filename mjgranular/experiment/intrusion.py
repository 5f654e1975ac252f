"""Intrusion, the first experiment: the force on a body moved on a prescribed path."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import mujoco
import numpy as np

from mjgranular._util.checks import check_count, check_kind, is_finite
from mjgranular.errors import InputError, UnknownNameError, shown
from mjgranular.experiment.drop import loading
from mjgranular.experiment.slips import warn_of_slips
from mjgranular.experiment.trajectory import degrees
from mjgranular.sand import Sand
from mjgranular.scheme import Explicit

Intruder = Literal["plate", "sphere", "cylinder", "capsule", "box"]
_BODY = "intruder"


@dataclass(frozen=True)
class Intrusion:
    """An intruder on a straight path through level sand, SI units and radians.

    The path lies in the plane y = 0 and is travelled at constant speed, the intruder kept at its
    tilt; it is moved, not pushed, so that its mass plays no part. `law` and `resolution` are those
    of `PlainSand`.

    Attributes:
        intruder: shape of the intruder, if no model is given. A plate is `size` square and a tenth
            as thick, a sphere has that diameter, a box that edge; a cylinder or capsule has a
            quarter of it as diameter and stands upright.
        size: size of that shape [m].
        model: MJCF file to take the intruder from.
        geom: name of the geom in that file. Default: all of it.
        tilt: tilt of the intruder: positive lifts its +x side [rad].
        direction: direction of motion below the horizontal; 0 is along +x [rad].
        speed: speed, which matters to laws with inertia and to validity [m/s].
        start: depth of the deepest point at the start [m].
        depth: depth of the deepest point at the end of a path that goes down or up [m].
        distance: length of the path [m]. Default: as far as `depth` asks for.
        points: number of samples.
        medium: name of the sand, see `mjgranular list media`, or a YAML file.
    """

    intruder: Intruder = "plate"
    size: float = 0.04
    model: Path | None = None
    geom: str | None = None
    tilt: float = 0.0
    direction: float = math.pi / 2
    speed: float = 0.01
    start: float = 0.0
    depth: float = 0.1
    distance: float | None = None
    points: int = 101
    medium: str = "quikrete_medium"
    law: str | None = None
    resolution: int | None = None

    def __post_init__(self) -> None:
        if self.intruder not in get_args(Intruder):
            raise UnknownNameError("intruder", self.intruder, get_args(Intruder))
        for name, value in (("size", self.size), ("speed", self.speed)):
            if not (is_finite(value) and value > 0):
                raise InputError(f"the {name} must be positive and finite, not {shown(value)}")
        for name in ("tilt", "direction", "start", "depth"):
            if not is_finite(getattr(self, name)):
                raise InputError(f"the {name} must be finite, not {shown(getattr(self, name))}")
        for name in ("tilt", "direction"):
            if not abs(getattr(self, name)) <= math.pi:
                raise InputError(
                    f"the {name} must be within 180 degrees (pi = 3.1416 rad) either way, not "
                    f"{degrees(getattr(self, name)):g} degrees ({getattr(self, name):.4g} rad)"
                )
        check_count("points", self.points)
        if self.points < 2:
            raise InputError(f"a path needs at least 2 points, not {self.points}")
        if self.geom is not None and self.model is None:
            raise InputError("--geom names a geom of a model: give the model too")
        _ = self.length

    @property
    def title(self) -> str:
        """Name of what is moved."""
        if self.model is not None:
            return self.geom or self.model.name
        return f"{self.intruder} of {self.size * 1e3:g} mm"

    @property
    def length(self) -> float:
        """Length of the path [m]."""
        if self.distance is not None:
            if not (math.isfinite(self.distance) and self.distance > 0):
                raise InputError(f"the distance must be positive, not {self.distance} m")
            return self.distance
        down = math.sin(self.direction)
        if abs(down) < 1e-9:
            raise InputError("a level path has no end in depth: give its --distance")
        length = (self.depth - self.start) / down
        if length <= 0:
            raise InputError(
                f"the path never gets from {self.start} m to {self.depth} m: it goes "
                f"{'down' if down > 0 else 'up'}"
            )
        return length

    def config(self) -> dict[str, Any]:
        """The intrusion in plain values."""
        return {**asdict(self), "model": None if self.model is None else str(self.model)}


@dataclass(frozen=True)
class IntrusionResult:
    """Force on the intruder along its path.

    Attributes:
        intrusion: what was asked for.
        law: name of the law that acted.
        elements: number of elements.
        travelled: distance from the start [m], shape (n,).
        depth: of the deepest point [m], shape (n,).
        force: against the motion, lift (up, across the motion), sideways (+y) [N], shape (n, 3).
        moment: about the intruder's centre of mass, world axes [N m], shape (n, 3).
        valid: whether the law held, shape (n,).
    """

    intrusion: Intrusion
    law: str
    elements: int
    travelled: np.ndarray
    depth: np.ndarray
    force: np.ndarray
    moment: np.ndarray
    valid: np.ndarray

    def rows(self) -> list[dict[str, Any]]:
        """One row a point, in plain numbers."""
        names = ("resistance", "lift", "sideways")
        return [
            {
                "travelled": float(self.travelled[i]),
                "depth": float(self.depth[i]),
                **{name: float(self.force[i, k]) for k, name in enumerate(names)},
                **{f"moment_{axis}": float(self.moment[i, k]) for k, axis in enumerate("xyz")},
                "valid": bool(self.valid[i]),
            }
            for i in range(len(self.depth))
        ]


def run_intrusion(intrusion: Intrusion) -> IntrusionResult:
    """Moves the intruder along its path and measures.

    Raises:
        InputError: the model cannot be read.
        UnknownNameError: a name that does not exist.
    """
    check_kind(intrusion, Intrusion, "run_intrusion")
    warn_of_slips(
        lengths={"the depth at the end": intrusion.depth, "the path": intrusion.distance},
        speed=intrusion.speed,
    )
    model = _model(intrusion)
    geoms = None if intrusion.model is None or intrusion.geom is None else intrusion.geom
    sand = Sand(
        model,
        medium=intrusion.medium,
        law=intrusion.law,
        geoms=geoms,
        resolution=intrusion.resolution,
        scheme=Explicit(prescribed=True),
    )
    data = mujoco.MjData(model)
    down, along = math.sin(intrusion.direction), math.cos(intrusion.direction)
    motion = np.array([along, 0.0, -down])
    lift = np.array([down, 0.0, along])
    mujoco.mju_axisAngle2Quat(data.qpos[3:7], [0.0, -1.0, 0.0], intrusion.tilt)
    data.qvel[:3] = intrusion.speed * motion
    bodies = sand.report(data).bodies
    data.qpos[2] += max(body.depth for body in bodies) - intrusion.start
    origin = data.qpos[:3].copy()
    travelled = np.linspace(0.0, intrusion.length, intrusion.points)
    depth, force, moment, valid = [], [], [], []
    center = None
    for distance in travelled:
        data.qpos[:3] = origin + distance * motion
        bodies = sand.report(data).bodies
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        center = data.subtree_com[1]
        total = sum((body.force for body in bodies), np.zeros(3))
        turning = np.zeros(3)
        for body in bodies:
            at = data.xipos[model.body(body.body).id]
            turning += body.moment + np.cross(at - center, body.force)
        depth.append(max(body.depth for body in bodies))
        force.append([-total @ motion, total @ lift, total[1]])
        moment.append(turning)
        valid.append(all(body.valid for body in bodies))
    return IntrusionResult(
        intrusion=intrusion,
        law=intrusion.law or sand.law.name,
        elements=len(sand.elements),
        travelled=travelled,
        depth=np.array(depth),
        force=_without_rounding(np.array(force)),
        moment=_without_rounding(np.array(moment), least=1e-12 * np.abs(force).max()),
        valid=np.array(valid),
    )


def _without_rounding(values: np.ndarray, least: float = 0.0) -> np.ndarray:
    """The values, with zeros for what is nothing beside the greatest of them."""
    return np.where(np.abs(values) < max(1e-12 * np.abs(values).max(), least), 0.0, values)


def _model(intrusion: Intrusion) -> mujoco.MjModel:
    """The intruder on a free joint."""
    if intrusion.model is None:
        spec = mujoco.MjSpec()
        body = spec.worldbody.add_body(name=_BODY)
        body.add_freejoint()
        kind, size = _shape(intrusion.intruder, intrusion.size)
        body.add_geom(name=_BODY, type=kind, size=size)
        return spec.compile()
    with loading(intrusion.model):
        spec = mujoco.MjSpec.from_file(str(intrusion.model))
        source = spec.compile()
    roots = [body for body in spec.worldbody.bodies if _has_geom(body)]
    if intrusion.geom is not None:
        geom = mujoco.mj_name2id(source, mujoco.mjtObj.mjOBJ_GEOM, intrusion.geom)
        if geom < 0:
            known = [source.geom(g).name for g in range(source.ngeom)]
            raise UnknownNameError("geom of the model", intrusion.geom, [k for k in known if k])
        if source.geom_bodyid[geom] == 0:
            raise InputError(
                f"geom {intrusion.geom!r} is fixed to the world: an intruder is a geom of a body"
            )
        root = source.body(int(source.body_rootid[source.geom_bodyid[geom]])).name
        roots = [body for body in roots if body.name == root] or roots
    if len(roots) != 1:
        names = ", ".join(body.name or "(no name)" for body in roots)
        raise InputError(
            f"{intrusion.model} has {len(roots)} bodies in its world ({names}): an intruder is "
            "one of them, name a geom of it"
        )
    # The intruder is rigid, moved as a whole, and alone: what drives it, binds it, reads it or lies
    # below it goes first, since it names what goes then.
    others = [*spec.sensors, *spec.actuators, *spec.equalities, *spec.tendons, *spec.keys]
    others += [*spec.pairs, *spec.excludes, *spec.worldbody.geoms]
    others += [joint for body in spec.bodies for joint in body.joints]
    others += [body for body in spec.worldbody.bodies if body.name != roots[0].name]
    for other in others:
        spec.delete(other)
    roots[0].add_freejoint()
    try:
        return spec.compile()
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{intrusion.model} cannot be moved as one rigid body: {reason}") from None


def _has_geom(body: Any) -> bool:
    return bool(body.geoms) or any(_has_geom(child) for child in body.bodies)


def _shape(intruder: Intruder, size: float) -> tuple[mujoco.mjtGeom, list[float]]:
    kinds = mujoco.mjtGeom
    half = size / 2
    return {
        "plate": (kinds.mjGEOM_BOX, [half, half, half / 10]),
        "box": (kinds.mjGEOM_BOX, [half, half, half]),
        "sphere": (kinds.mjGEOM_SPHERE, [half, 0.0, 0.0]),
        "cylinder": (kinds.mjGEOM_CYLINDER, [half / 4, half, 0.0]),
        "capsule": (kinds.mjGEOM_CAPSULE, [half / 4, half - half / 4, 0.0]),
    }[intruder]
