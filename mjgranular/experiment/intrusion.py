"""Intrusion: the force on a body that is moved on a prescribed path."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import mujoco
import numpy as np

from mjgranular._util.checks import check_count, check_finite, check_kind, check_name
from mjgranular.errors import InputError, loading
from mjgranular.experiment.trajectory import degrees
from mjgranular.law import get_law
from mjgranular.medium import get_medium
from mjgranular.models import Projectile
from mjgranular.sand import Sand
from mjgranular.scheme import Explicit
from mjgranular.shape.select import find_all

Intruder = Literal["plate", "sphere", "cylinder", "capsule", "box"]
_FORCES = ("resistance", "lift", "sideways")
_THIN = {"plate": 0.1, "cylinder": 0.25, "capsule": 0.25}  # thickness, in `Intrusion.size`

_MOST_POINTS = 100_000  # chosen: about a minute
_HEAVY, _STEP = 1e12, 1e-5  # inertia of what keeps its motion [kg, kg m^2], time step [s]; chosen


@dataclass(frozen=True)
class Intrusion:
    """An intruder on a straight path through level sand, SI units and radians.

    The path is in the plane y = 0; speed and tilt are constant. The intruder is moved, not pushed,
    so its mass has no effect. `law` and `resolution` are those of `PlainSand`.

    Attributes:
        intruder: shape of the intruder, if no model is given. A plate is `size` square and a tenth
            as thick, a sphere has that diameter, a box that edge; a cylinder or capsule has a
            quarter of it as diameter and stands upright.
        size: size of that shape [m].
        model: MJCF file to take the intruder from.
        geom: name of the geom in that file. Default: all of it.
        tilt: tilt of the intruder: positive lifts its +x side [rad].
        direction: direction of motion below the horizontal; 0 is along +x [rad].
        speed: speed, which affects laws with inertia and validity [m/s].
        start: depth of the deepest point at the start [m].
        depth: depth of the deepest point at the end of a path that goes down or up [m].
        distance: length of the path [m]. Default: as far as `depth` asks for.
        points: number of samples, from 2 to 100 000.
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
        check_name("intruder", self.intruder, get_args(Intruder))
        for name, value in (("size", self.size), ("speed", self.speed)):
            check_finite(f"the {name}", value, positive=True)
        for name in ("tilt", "direction", "start", "depth"):
            check_finite(f"the {name}", getattr(self, name))
        for name in ("tilt", "direction"):
            if not abs(getattr(self, name)) <= math.pi:
                raise InputError(
                    f"the {name} must be within 180 degrees (pi = 3.1416 rad) either way, got "
                    f"{degrees(getattr(self, name)):g} degrees ({getattr(self, name):.4g} rad)"
                )
        check_count("points", self.points, least=2, most=_MOST_POINTS)
        if self.geom is not None and self.model is None:
            raise InputError("--geom is the name of a geom of a model: give the model too")
        for name in ("intruder", "size") if self.model is not None else ():
            if getattr(self, name) != getattr(Intrusion, name):
                raise InputError(f"the intruder is a shape or of a model: omit --model or --{name}")
        if self.distance is not None and self.depth != Intrusion.depth:
            raise InputError("--depth and --distance both determine the end of the path: omit one")
        _ = self.length

    @property
    def title(self) -> str:
        if self.model is not None:
            return self.geom or self.model.name
        return f"{self.intruder} of {self.size * 1e3:g} mm"

    @property
    def length(self) -> float:
        """Length of the path [m]."""
        if self.distance is not None:
            check_finite("the distance", self.distance, "m", positive=True)
            return self.distance
        down = math.sin(self.direction)
        if abs(down) < 1e-9:
            raise InputError("a level path has no end in depth: give its --distance")
        length = (self.depth - self.start) / down
        if length <= 0:
            way = "down" if down > 0 else "up"
            raise InputError(
                f"the path never gets from {self.start} m to {self.depth} m: it goes {way}"
            )
        return length


@dataclass(frozen=True)
class IntrusionResult:
    """Force on the intruder along its path.

    Attributes:
        intrusion: the run that was requested.
        law: name of the law.
        elements: number of elements.
        travelled: distance from the start [m], shape (n,).
        depth: depth of the deepest point [m], shape (n,).
        force: resistance, lift (up, across the motion) and sideways force (+y) [N], shape (n, 3).
        moment: moment about the intruder's center of mass, world axes [N m], shape (n, 3).
        valid: whether the law was valid, shape (n,).
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
        """Return one row per point, in plain numbers."""
        columns = {
            "travelled": self.travelled,
            "depth": self.depth,
            **dict(zip(_FORCES, self.force.T, strict=True)),
            **{f"moment_{axis}": values for axis, values in zip("xyz", self.moment.T, strict=True)},
            "valid": self.valid,
        }
        rows = zip(*(values.tolist() for values in columns.values()), strict=True)
        return [dict(zip(columns, row, strict=True)) for row in rows]

    def row(self) -> dict[str, Any]:
        """Return one row: force at the end of the path, the greatest resistance, and the work."""
        resistance = self.force[:, 0]
        greatest = int(resistance.argmax())
        return {
            "law": self.law,
            "medium": self.intrusion.medium,
            "elements": self.elements,
            "travelled": float(self.travelled[-1]),
            "final_depth": float(self.depth[-1]),
            **dict(zip(_FORCES, map(float, self.force[-1]), strict=True)),
            "greatest_resistance": float(resistance[greatest]),
            "depth_of_greatest": float(self.depth[greatest]),
            "work": float(np.trapezoid(resistance, self.travelled)),
            "within_validity": float(self.valid.mean()),
        }


def run_intrusion(intrusion: Intrusion) -> IntrusionResult:
    """Move the intruder along its path and measure forces."""
    check_kind(intrusion, Intrusion, "run_intrusion")
    law = get_law(intrusion.law, get_medium(intrusion.medium))
    model = _model(intrusion)
    model.dof_armature[:], model.opt.timestep = _HEAVY, _STEP
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)
    sand = Sand(
        model,
        medium=intrusion.medium,
        law=law,
        geoms=intrusion.geom,
        resolution=intrusion.resolution,
        # Only the implicit scheme has the inertia of sand that moves along.
        scheme="implicit" if law.adds_mass else Explicit(prescribed=True),
    )
    down, along = math.sin(intrusion.direction), math.cos(intrusion.direction)
    motion = _without_rounding(np.array([along, 0.0, -down]))
    lift = np.array([down, 0.0, along])
    tilted, ids = np.zeros(4), np.unique(sand.elements["body"])
    mujoco.mju_axisAngle2Quat(tilted, [0.0, -1.0, 0.0], intrusion.tilt)
    mujoco.mju_mulQuat(data.qpos[3:7], tilted, model.qpos0[3:7])
    data.qvel[:3] = intrusion.speed * motion
    bodies = sand.report(data).bodies
    data.qpos[2] += max(body.depth for body in bodies) - intrusion.start
    origin = data.qpos[:3].copy()
    travelled = np.linspace(0.0, intrusion.length, intrusion.points)
    depth, force, moment, valid = [], [], [], []
    for distance in travelled:
        data.qpos[:3] = origin + distance * motion
        bodies = sand.report(data).bodies
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        center = data.subtree_com[1]
        forces = np.array([body.force for body in bodies])
        turning = np.cross(data.xipos[ids] - center, forces).sum(axis=0)
        total = forces.sum(axis=0)
        depth.append(max(body.depth for body in bodies))
        force.append([-total @ motion, total @ lift, total[1]])
        moment.append(turning + sum(body.moment for body in bodies))
        valid.append(all(body.valid for body in bodies))
    return IntrusionResult(
        intrusion=intrusion,
        law=intrusion.law or law.name,
        elements=len(sand.elements),
        travelled=travelled,
        depth=np.array(depth),
        force=_without_rounding(np.array(force)),
        moment=_without_rounding(np.array(moment), least=1e-12 * np.abs(force).max()),
        valid=np.array(valid),
    )


def _without_rounding(values: np.ndarray, least: float = 0.0) -> np.ndarray:
    """Replace values that are rounding errors, compared to the largest, by zeros."""
    return np.where(np.abs(values) < max(1e-12 * np.abs(values).max(), least), 0.0, values)


def _model(intrusion: Intrusion) -> mujoco.MjModel:
    """Make the model of the intruder, on a free joint."""
    if intrusion.model is None:
        spec = mujoco.MjSpec()
        body = spec.worldbody.add_body(name="intruder")
        body.add_freejoint()
        thickness = _THIN.get(intrusion.intruder, 1.0) * intrusion.size
        kind, size = Projectile(intrusion.size, thickness, shape=intrusion.intruder).solid
        body.add_geom(name="intruder", type=kind, size=size)
        return spec.compile()
    with loading(intrusion.model):
        spec = mujoco.MjSpec.from_file(str(intrusion.model))
        source = spec.compile()
    roots = [body for body in spec.worldbody.bodies if _has_geom(body)]
    if intrusion.geom is not None:
        (geom,) = find_all(source, "geom", intrusion.geom)
        if source.geom_bodyid[geom] == 0:
            raise InputError(f"geom {intrusion.geom!r} is fixed to the world: use a geom of a body")
        root = source.body(int(source.body_rootid[source.geom_bodyid[geom]])).name
        roots = [body for body in roots if body.name == root] or roots
    if len(roots) != 1:
        names = ", ".join(body.name or "(no name)" for body in roots)
        raise InputError(
            f"{intrusion.model} has {len(roots)} bodies ({names}): use --geom with a geom of one"
        )
    # The intruder is rigid and alone. What refers to joints, geoms and bodies is deleted first.
    others = [*spec.sensors, *spec.actuators, *spec.equalities, *spec.tendons, *spec.keys]
    others += [*spec.pairs, *spec.excludes, *spec.worldbody.geoms]
    others += [joint for body in spec.bodies for joint in body.joints]
    others += [body for body in spec.worldbody.bodies if body.name != roots[0].name]
    for other in others:
        spec.delete(other)
    roots[0].add_freejoint()
    with loading(f"{intrusion.model} as one rigid body"):
        return spec.compile()


def _has_geom(body: Any) -> bool:
    return bool(body.geoms) or any(_has_geom(child) for child in body.bodies)
