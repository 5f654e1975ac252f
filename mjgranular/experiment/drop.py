"""A model dropped on, dragged through or placed on sand."""

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, asdict, dataclass
from pathlib import Path
from typing import Any, Self

import mujoco
import numpy as np

from mjgranular._util.checks import check_finite, check_kind, is_finite, kind_of
from mjgranular._util.io import check_regular, checked_fields, place
from mjgranular.engine import show_prints
from mjgranular.errors import (
    FloorWarning,
    InputError,
    OutputError,
    UnknownNameError,
    loading,
    shown,
    warn_user,
)
from mjgranular.experiment.ground import PlainSand, hide_replaced, refuse_floors, warn_of_carrying
from mjgranular.experiment.sampling import REST_WINDOW, Recorder, RestWatch, WorkMeter
from mjgranular.models import robot_path
from mjgranular.render import TrackRecorder, Tracks
from mjgranular.render.scenery import add_scenery, place_sun
from mjgranular.sand import Sand
from mjgranular.sand.prepare import fitted, geoms_in_sand
from mjgranular.sand.report import BodyReport
from mjgranular.surface.floors import FloorWatch

LARGEST_STEP = 1e-4
"""Of a run with the explicit scheme whose time step is left to us [s]; chosen, not measured."""

_PROGRESS_STEPS = 1000  # between two calls of `progress`


@dataclass(frozen=True)
class Drop(PlainSand):
    """A run of a model on sand, SI units and radians; the sand is described as in `PlainSand`.

    Attributes:
        model: the MJCF file, or the name of a robot (`models.robot_path`).
        keyframe: the keyframe to start from, by name, or by number if it has none. Default: none.
        height: initial height of the lowest point above the surface [m]. Default: as the model is.
        velocity: velocity at the start, down [m/s].
        duration: simulated time [s].
        timestep: time step [s]. Default: the model's, at most 1e-4 s with the explicit scheme.
    """

    model: Path
    _: KW_ONLY
    keyframe: str | None = None
    height: float | None = None
    velocity: float = 0.0
    duration: float = 1.0
    timestep: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.model, str):
            object.__setattr__(self, "model", Path(self.model))
        if not isinstance(self.model, Path):
            raise InputError(
                f"a drop is of an MJCF file, Drop('robot.xml'), got {kind_of(self.model)}: for "
                "a model in memory use Sand and sand.step(data)"
            )
        if self.height is not None and not (is_finite(self.height) and self.height >= 0):
            raise InputError(f"height must be finite and not negative, got {shown(self.height)} m")
        check_finite("the velocity", self.velocity, "m/s")
        for name, value in (("duration", self.duration), ("time step", self.timestep)):
            if value is not None:
                check_finite(f"the {name}", value, "s", positive=True)

    @classmethod
    def from_config(cls, config: object) -> Self:
        """Return the drop of which `config.json` has these values."""
        where = "the drop's configuration"
        plain = {**config} if isinstance(config, dict) else {}
        for name in ("state", "site"):  # of version 0.2
            plain.pop(name, None)
        plain = checked_fields(cls, plain, where)
        if "model" not in plain:
            raise OutputError(f"{where} names no model")
        for key, value in plain.items():
            plain[key] = tuple(value) if isinstance(value, list) else value
        return cls(**plain)

    @property
    def title(self) -> str:
        return self.model.name


@dataclass(frozen=True)
class BodySummary:
    """Result of a drop for one body.

    Attributes:
        body: its name.
        greatest_depth: [m]; negative if it never met the sand.
        greatest_force: magnitude [N].
        energy_into_sand: work of the body on the sand [J].
        within_validity: share of the samples in the sand at which the law was valid, 0 to 1; None
            if it never met the sand, or the law has no limits.
        exceeded: measures of validity whose limits it passed at a sample, with the greatest values.
    """

    body: str
    greatest_depth: float
    greatest_force: float
    energy_into_sand: float
    within_validity: float | None
    exceeded: dict[str, float]

    @classmethod
    def of(cls, reports: Sequence[BodyReport], energy: float, force: float, depth: float) -> Self:
        """Summarize a body: all samples; energy [J], force [N] and depth [m] but at the last."""
        in_sand = [report for report in reports if report.depth > 0]
        exceeded: dict[str, float] = {}
        for report in in_sand:
            for standing in report.validity:
                if not standing.holds and standing.value is not None:
                    measure = standing.limit.measure
                    exceeded[measure] = max(exceeded.get(measure, 0.0), standing.value)
        valid = [report.valid for report in in_sand if report.validity]
        return cls(
            body=reports[0].body,
            greatest_depth=float(max(depth, reports[-1].depth)),
            greatest_force=float(max(force, np.linalg.norm(reports[-1].force))),
            energy_into_sand=float(energy),
            within_validity=sum(valid) / len(valid) if valid else None,
            exceeded=exceeded,
        )


@dataclass(frozen=True)
class DropResult:
    """A finished run.

    Attributes:
        drop: the run that was requested.
        xml: the model as it ran, by daylight.
        medium: name of the medium, or the file that it was read from.
        law: name of the law.
        scheme: name of the scheme.
        timestep: [s].
        elements: number of elements.
        rest: time from which no body of the model moves or turns [s]; None if one still does.
        bodies: one summary per body.
        t: times of the samples [s], shape (n,).
        qpos: shape (n, nq).
        qvel: shape (n, nv).
        depth: depth of each body [m], shape (n, bodies).
        point: point of action on each body's deepest element [m], shape (n, bodies, 3).
        force: force of the sand on each body [N], shape (n, bodies, 3).
        power: power of the sand on each body [W], shape (n, bodies).
        prints: tracks in the sand; None for sand without memory.
    """

    drop: Drop
    xml: str
    medium: str
    law: str
    scheme: str
    timestep: float
    elements: int
    rest: float | None
    bodies: tuple[BodySummary, ...]
    t: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    depth: np.ndarray
    point: np.ndarray
    force: np.ndarray
    power: np.ndarray
    prints: Tracks | None = None

    def summary(self) -> dict[str, Any]:
        """Return the result in plain numbers, SI units."""
        same = ("law", "medium", "scheme", "timestep", "elements")
        return {
            "model": self.drop.title,
            **{name: getattr(self, name) for name in same},
            "duration": float(self.t[-1]),
            "at_rest": self.rest is not None,
            "rest_time": self.rest,
            "bodies": [asdict(body) for body in self.bodies],
        }

    def row(self) -> dict[str, Any]:
        """Return the result as one row of a table: all bodies together, then each of them."""
        summary, bodies = self.summary(), self.bodies
        del summary["bodies"]
        valid = [body.within_validity for body in bodies if body.within_validity is not None]
        row = {
            **summary,
            "greatest_depth": max(body.greatest_depth for body in bodies),
            "greatest_force": max(body.greatest_force for body in bodies),
            "energy_into_sand": sum(body.energy_into_sand for body in bodies),
            "within_validity": min(valid, default=None),
        }
        for body in map(asdict, bodies):
            name, exceeded = body.pop("body"), body.pop("exceeded")
            row |= {f"{name}: {key}": value for key, value in body.items()}
            row |= {f"{name}: {measure} reached": value for measure, value in exceeded.items()}
        return row


def run_drop(drop: Drop, *, progress: Callable[[float], None] | None = None) -> DropResult:
    """Run a model on sand; `progress` is called now and then with the simulated time [s].

    Raises:
        InputError: the model cannot be read, or cannot be lifted or thrown.
        UnknownNameError: a name that the model does not have.
        UnstableError: the simulation diverged.

    Warns:
        FloorWarning: the model's own ground has carried it, without `keep_floor`.
    """
    check_kind(drop, Drop, "run_drop", "Drop(path, ...)")
    model, xml = load(drop)
    if not drop.keep_floor:
        refuse_floors(model, drop.sand)
    with warnings.catch_warnings(action="ignore", category=FloorWarning):
        sand = Sand(model, drop.sand)
    data = mujoco.MjData(model)
    _place(drop, model, data, sand)
    tracks = None if sand.memory is None else TrackRecorder(sand, data, drop.duration)
    recorder = Recorder(1 + model.nq + model.nv, keep=2048)

    def sample(time: float) -> None:
        recorder.take(time, data.qpos, data.qvel, report=sand.report(data).bodies)

    recorder.due()
    sample(0.0)
    meter = WorkMeter(sand, data)
    floors = FloorWatch(model, geoms_in_sand(model, drop.sand), drop.surface)
    watch, rest = RestWatch(), None
    check_every = max(1, round(REST_WINDOW / model.opt.timestep / 20))
    points, begin = _watched(model), data.time
    total = math.ceil(drop.duration / model.opt.timestep - 1e-9)
    for step in range(1, total + 1):
        sand.step(data)
        time = data.time - begin
        floors.look(data)
        meter.add()
        if recorder.due() or step == total:
            sample(time)
        if tracks is not None:
            tracks.look(time, last=step == total)
        if step % check_every == 0:
            rest = watch.since if watch.still(time, points(data)) else None
        if progress is not None and step % _PROGRESS_STEPS == 0:
            progress(time)
    if not drop.keep_floor:
        warn_of_carrying(model, floors)
    rows, totals = recorder.rows(), (-meter.work, meter.force, meter.depth)
    reports = recorder.reports
    arrays = {
        name: np.array([[getattr(body, name) for body in bodies] for bodies in reports])
        for name in ("depth", "point", "force", "power")
    }
    return DropResult(
        drop=drop,
        xml=xml,
        medium=drop.medium or sand.medium.name,
        law=drop.law or sand.law.name,
        scheme=sand.scheme.name,
        timestep=float(model.opt.timestep),
        elements=len(sand.elements),
        rest=rest,
        bodies=tuple(map(BodySummary.of, zip(*reports, strict=True), *totals)),
        t=rows[:, 0],
        qpos=rows[:, 1 : 1 + model.nq],
        qvel=rows[:, 1 + model.nq :],
        **arrays,
        prints=None if tracks is None else tracks.prints(),
    )


def _watched(model: mujoco.MjModel) -> Callable[[mujoco.MjData], np.ndarray]:
    """Return a function for three points of each body that can move, as far out as its geoms."""
    moving = np.flatnonzero(model.body_weldid)
    size = np.zeros(model.nbody)
    reach = np.linalg.norm(model.geom_pos, axis=1) + model.geom_rbound
    np.maximum.at(size, model.geom_bodyid, reach)
    size = size[moving, None]

    def points(data: mujoco.MjData) -> np.ndarray:
        place, axes = data.xpos[moving], data.xmat[moving].reshape(-1, 3, 3)
        return np.stack([place, place + size * axes[:, :, 0], place + size * axes[:, :, 1]])

    return points


def load(drop: Drop) -> tuple[mujoco.MjModel, str]:
    """Return the compiled model by daylight, and its XML."""
    with loading(drop.title):
        spec = read(drop)
        make_ready(spec, drop)
        xml = spec.to_xml()
        model = spec.compile()
        if drop.memory is not None:  # the skin has the size of the memory that fits the model
            show_prints(spec, fitted(model, drop.sand))
            model = spec.compile()
        hide_replaced(model, drop.sand)
        place_sun(model)
        return model, xml


def read(drop: Drop) -> mujoco.MjSpec:
    """Read the model from its file, and set the time step of the run."""
    file = robot_path(drop.model)
    check_regular(file, "the model")
    if file.suffix.lower() not in (".xml", ".urdf", ".mjz", ".zip"):
        raise InputError(f"cannot read the model {place(file)}: use MJCF or URDF, .xml or .urdf")
    spec = mujoco.MjSpec.from_file(str(file))
    if drop.timestep is not None:
        spec.option.timestep = drop.timestep
    elif drop.scheme == "explicit":
        spec.option.timestep = min(spec.option.timestep, LARGEST_STEP)
    return spec


def make_ready(spec: mujoco.MjSpec, drop: Drop) -> None:
    """Give a model scenery, and an integrator that works with sand.

    Warns:
        GranularWarning: the model asks for RK4.
    """
    if spec.option.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        warn_user(
            f"{drop.title} asks for the integrator RK4, with which sand cannot hold a body at "
            "rest: it runs with implicitfast"
        )
    add_scenery(spec, drop.surface)


def start_from(model: mujoco.MjModel, data: mujoco.MjData, keyframe: str | None) -> None:
    """Set the state of a keyframe; None to change nothing."""
    if keyframe is None:
        return
    known = [model.key(k).name or str(k) for k in range(model.nkey)]
    if keyframe not in known:
        raise UnknownNameError("keyframe of the model", keyframe, known)
    mujoco.mj_resetDataKeyframe(model, data, known.index(keyframe))


def _place(drop: Drop, model: mujoco.MjModel, data: mujoco.MjData, sand: Sand) -> None:
    start_from(model, data, drop.keyframe)
    roots = _vertical_dofs(model)
    held = "the model has no free joint (in URDF: floating) and no vertical slide at its root"
    if drop.height is None and drop.velocity == 0.0:
        if model.body_parentid[model.jnt_bodyid].all():
            warn_user(f"{held}: its base is fixed to the world, and does not fall")
    elif not roots:
        raise InputError(f"{held}: --height and --velocity cannot move it; use a keyframe instead")
    for _, velocity, sign in roots:
        data.qvel[velocity] -= sign * drop.velocity
    if drop.height is not None:
        # Once is exact for a level surface; along a slope depth grows with its cosine.
        for _ in range(8):
            depth = max(body.depth for body in sand.report(data).bodies)
            for position, _, sign in roots:
                data.qpos[position] += sign * (drop.height + depth)


def _vertical_dofs(model: mujoco.MjModel) -> list[tuple[int, int, float]]:
    """Return index in `qpos` and `qvel` and sign of up, for each vertical joint of a root body."""
    found = []
    for joint in np.flatnonzero(model.body_parentid[model.jnt_bodyid] == 0):
        position, velocity = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            found.append((position + 2, velocity + 2, 1.0))
        elif model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE:
            up = float(model.jnt_axis[joint][2])
            if abs(up) > 0.999:
                found.append((position, velocity, math.copysign(1.0, up)))
    return found
