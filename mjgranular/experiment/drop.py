"""A user's model dropped on, dragged through or stood upon sand."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import KW_ONLY, asdict, dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from mjgranular._util.checks import is_finite, kind_of
from mjgranular._util.io import check_regular, place
from mjgranular._util.io import checked_fields, is_text
from mjgranular.engine import show_prints
from mjgranular.errors import (
    FloorWarning,
    GranularError,
    InputError,
    OutputError,
    UnknownNameError,
    shown,
    warn_user,
)
from mjgranular.experiment.ground import (
    PlainSand,
    hide_replaced,
    refuse_contradiction,
    refuse_floors,
    warn_of_carrying,
    watch_floors,
)
from mjgranular.experiment.scenery import add_cut_prints, add_scenery, place_sun
from mjgranular.experiment.slips import warn_of_slips
from mjgranular.experiment.tip import TipWatch
from mjgranular.experiment.trajectory import Recorder
from mjgranular.experiment.watch import REST_WINDOW, RestWatch
from mjgranular.models import Chain, robot_path
from mjgranular.prints import Prints, PrintsRecorder
from mjgranular.relief.memory import Memory, as_memory
from mjgranular.sand import Sand
from mjgranular.sand.prepare import fitted
from mjgranular.sand.report import BodyReport
from mjgranular.sand.work import WorkMeter
from mjgranular.surface import Surface

LARGEST_STEP = 1e-4
"""Of a run with the explicit scheme whose time step is left to us [s]; chosen, not measured."""

_PROGRESS_STEPS = 1000  # between two calls of `progress`


@dataclass(frozen=True)
class Drop(PlainSand):
    """A run of a user's model on sand, SI units and radians.

    The sand is described as in `PlainSand`.

    Attributes:
        model: the MJCF file, the name of a robot (`models.robot_path`), or a chain.
        keyframe: name of the keyframe to start from. Default: the model as it is.
        height: height of the lowest point above the surface at the start [m]. Default: as the
            model is.
        velocity: velocity at the start, down [m/s].
        duration: simulated time [s].
        timestep: time step [s]. Default: the model's, at most 1e-4 s with the explicit scheme.
        state: `qpos` and `qvel` to start from, one after the other; None for the model's own.
        site: name of a site whose stop is looked for; needs a level surface.
    """

    model: Path | Chain
    _: KW_ONLY
    keyframe: str | None = None
    height: float | None = None
    velocity: float = 0.0
    duration: float = 1.0
    timestep: float | None = None
    state: tuple[float, ...] | None = None
    site: str | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.model, str):
            object.__setattr__(self, "model", Path(self.model))
        if not isinstance(self.model, (Path, Chain)):
            raise InputError(
                f"a drop is of an MJCF file, Drop('robot.xml'), not of {kind_of(self.model)}: for "
                "a model that is there already use Sand and sand.step(data)"
            )
        if self.height is not None and not (is_finite(self.height) and self.height >= 0):
            raise InputError(
                f"the height must be finite and not negative, not {shown(self.height)} m"
            )
        if not is_finite(self.velocity):
            raise InputError(f"the velocity must be finite, not {shown(self.velocity)} m/s")
        for name, value in (("duration", self.duration), ("time step", self.timestep)):
            if value is not None and not (is_finite(value) and value > 0):
                raise InputError(f"the {name} must be positive and finite, not {shown(value)} s")

    def config(self) -> dict[str, Any]:
        """The drop in plain values; `from_config` makes a drop of them again."""
        if isinstance(self.model, Chain):
            # Without a limit the torque is infinite, which JSON does not know.
            model = {k: None if v == math.inf else v for k, v in asdict(self.model).items()}
        else:
            model = str(self.model)
        return {**asdict(self), "model": model}

    @classmethod
    def from_config(cls, config: object) -> Drop:
        """The drop that `config` described.

        Raises:
            OutputError: it is of no drop; says what is wrong.
        """
        where = "the drop's configuration"
        plain = {**config} if isinstance(config, dict) else {}
        model = plain.pop("model", None)
        plain = {**checked_fields(cls, plain, where)}
        if isinstance(model, dict):
            chain = {**model}
            limited = chain.pop("torque", None)
            torque = math.inf if limited is None else limited
            plain["model"] = Chain(**checked_fields(Chain, chain, where), torque=torque)
        elif is_text(model):
            plain["model"] = Path(str(model))
        else:
            raise OutputError(f"{where} names no model")
        for key in ("bodies", "geoms", "groups", "state", "instead_of"):  # absent in older ones
            if plain.get(key) is not None:
                plain[key] = tuple(plain[key])
        return cls(**plain)

    @property
    def title(self) -> str:
        """Name of what runs, in a word or two."""
        if isinstance(self.model, Chain):
            return f"chain of {self.model.count}"
        return self.model.name


@dataclass(frozen=True)
class BodySummary:
    """Result of a drop for one body.

    Attributes:
        body: its name.
        greatest_depth: [m]; negative if it never met the sand.
        greatest_force: size [N].
        energy_into_sand: work of the body on the sand [J].
        within_validity: share of the samples in the sand at which the law held, 0 to 1; None if it
            never met the sand.
        exceeded: measures of validity whose limits it passed, with the greatest values.
    """

    body: str
    greatest_depth: float
    greatest_force: float
    energy_into_sand: float
    within_validity: float | None
    exceeded: dict[str, float]


@dataclass(frozen=True)
class DropResult:
    """A finished run.

    Attributes:
        drop: what was asked for.
        xml: the model as it ran, by daylight.
        medium: name of the medium, or the file that it was read from.
        law: name of the law that acted.
        timestep: [s].
        elements: number of elements.
        stop: time since it touched the sand [s] and depth [m] of the site when its vertical
            velocity was first zero; None if that was not looked for, or did not happen.
        rest: time from which every body stays where it is [s]; None if they still move.
        bodies: one summary a body.
        t: times of the samples [s], shape (n,).
        qpos: shape (n, nq).
        qvel: shape (n, nv).
        depth: of each body [m], shape (n, bodies).
        point: where it acts on each body's deepest element [m], shape (n, bodies, 3).
        force: of the sand on each body [N], shape (n, bodies, 3).
        power: of the sand on each body [W], shape (n, bodies).
        prints: what the sand remembered; None for sand that does not.
    """

    drop: Drop
    xml: str
    medium: str
    law: str
    scheme: str
    timestep: float
    elements: int
    stop: tuple[float, float] | None
    rest: float | None
    bodies: tuple[BodySummary, ...]
    t: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    depth: np.ndarray
    point: np.ndarray
    force: np.ndarray
    power: np.ndarray
    prints: Prints | None = None

    def summary(self) -> dict[str, Any]:
        """The result in plain numbers, SI units."""
        return {
            "model": self.drop.title,
            "law": self.law,
            "medium": self.medium,
            "scheme": self.scheme,
            "timestep": self.timestep,
            "elements": self.elements,
            "duration": float(self.t[-1]),
            "at_rest": self.rest is not None,
            "rest_time": self.rest,
            "bodies": [asdict(body) for body in self.bodies],
        }


def run_drop(drop: Drop, *, progress: Callable[[float], None] | None = None) -> DropResult:
    """Runs a user's model on sand.

    Args:
        drop: the run.
        progress: called now and then with the simulated time [s].

    Raises:
        InputError: the model cannot be read, or cannot be lifted or thrown.
        UnknownNameError: a name that the model does not have.
        UnstableError: the simulation diverged.

    Warns:
        FloorWarning: ground of the model's own has carried it, and `keep_floor` is not said.
    """
    if not isinstance(drop, Drop):
        raise InputError(f"run_drop takes a Drop(path, ...), not {kind_of(drop)}")
    warn_of_slips(lengths={"the height of the start": drop.height}, speed=drop.velocity)
    model, xml = load(drop)
    if not drop.keep_floor:
        refuse_floors(model, drop.sand)
    elif drop.instead_of:
        refuse_contradiction(model, drop.sand)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FloorWarning)
        sand = Sand(model, drop.sand)
    data = mujoco.MjData(model)
    _place(drop, model, data, sand)

    recorder = Recorder(1 + model.nq + model.nv, keep=2048)
    prints = None if sand.memory is None else PrintsRecorder(sand, data, drop.duration)
    watch, rest = RestWatch(), None
    ground = watch_floors(model, drop.sand)
    check_every = max(1, round(REST_WINDOW / model.opt.timestep / 20))
    moving = sorted({int(body) for body in sand.elements["body"]})
    begin = data.time
    total = math.ceil(drop.duration / model.opt.timestep - 1e-9)
    tip = (
        None if drop.site is None else TipWatch(model, data, drop.site, height=drop.surface_height)
    )
    recorder.due()
    recorder.take(0.0, data.qpos, data.qvel)
    meter = WorkMeter(sand, data)
    felt: dict[float, tuple[BodyReport, ...]] = {}
    if prints is not None:
        prints.look(0.0)
    for step in range(1, total + 1):
        sand.step(data)
        ground.look(data)
        meter.add()
        if tip is not None:
            tip.follow(data)
        if recorder.due() or step == total:
            recorder.take(data.time - begin, data.qpos, data.qvel)
            if prints is not None:
                felt[data.time - begin] = sand.report(data).bodies
        if prints is not None:
            prints.look(data.time - begin, last=step == total)
        if step % check_every == 0:
            still = watch.still(data.time - begin, data.xpos[moving])
            rest = watch.since if still else None
        if progress is not None and step % _PROGRESS_STEPS == 0:
            progress(data.time - begin)
    if not drop.keep_floor:
        warn_of_carrying(model, ground)
    stop = None if tip is None else tip.stop
    seen = None if prints is None else prints.prints()
    return _result(drop, xml, sand, recorder.rows(), -meter.work, stop, rest, seen, felt)


def load(drop: Drop) -> tuple[mujoco.MjModel, str]:
    """The compiled model by daylight, and its XML.

    Raises:
        InputError: MuJoCo cannot load it.
        UnknownNameError: it lacks a geom that the sand is to replace.
    """
    with loading(drop.title):
        spec = read(drop)
        make_ready(spec, drop)
        xml = spec.to_xml()
        if isinstance(drop.model, Chain):
            add_cut_prints(spec, as_memory(drop.memory))
        else:
            show_prints(spec, drop.sand)
        model = spec.compile()
        hide_replaced(model, drop.sand)
        place_sun(model)
        return model, xml


@contextmanager
def loading(title: object) -> Iterator[None]:
    """Has what MuJoCo raises say which model it is about, as an `InputError`."""
    try:
        yield
    except GranularError:
        raise
    except (ValueError, OSError, mujoco.FatalError) as error:
        reason = " ".join(str(error).split())
        ours = re.search("engine error: mjgranular '[^']*': (.*)", reason)
        raise InputError(ours[1] if ours else f"MuJoCo cannot load {title}: {reason}") from None


def read(drop: Drop) -> mujoco.MjSpec:
    """The model as it is in its file, with the time step of the run."""
    if isinstance(drop.model, Chain):
        spec = drop.model.spec()
    else:
        file = robot_path(drop.model)
        check_regular(file, "the model")
        if file.suffix.lower() not in (".xml", ".urdf", ".mjz", ".zip"):
            raise InputError(
                f"cannot read the model {place(file)}: a model is an MJCF or URDF file, .xml "
                "or .urdf"
            )
        spec = mujoco.MjSpec.from_file(str(file))
    if drop.timestep is not None:
        spec.option.timestep = drop.timestep
    elif drop.scheme == "explicit":
        spec.option.timestep = min(spec.option.timestep, LARGEST_STEP)
    return spec


def make_ready(spec: mujoco.MjSpec, drop: Drop) -> None:
    """Gives a user's model scenery, and an integrator that sand can be stepped with.

    A chain has both.

    Warns:
        GranularWarning: the model asks for RK4.
    """
    if isinstance(drop.model, Chain):
        return
    if spec.option.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        warn_user(
            f"{drop.title} asks for the integrator RK4, within which sand cannot hold a body at "
            "rest: it runs with implicitfast"
        )
    add_scenery(spec, drop.surface)


def memory_of(drop: Drop, model: mujoco.MjModel) -> Memory | None:
    """How the sand of a run remembers, on its model; None for sand that does not."""
    return as_memory(fitted(model, drop.sand).memory)


def surface_drawn(drop: Drop) -> Surface | None:
    """The surface that is to be drawn into pictures of a run; None where the model shows it."""
    return None if isinstance(drop.model, Chain) else drop.surface


def start_from(model: mujoco.MjModel, data: mujoco.MjData, keyframe: str | None) -> None:
    """Starts from a keyframe; None for as the model is.

    Raises:
        UnknownNameError: the model has no such keyframe; lists those it has.
    """
    if keyframe is None:
        return
    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, keyframe)
    if key < 0:
        known = [model.key(k).name for k in range(model.nkey)]
        raise UnknownNameError("keyframe of the model", keyframe, known)
    mujoco.mj_resetDataKeyframe(model, data, key)


def _place(drop: Drop, model: mujoco.MjModel, data: mujoco.MjData, sand: Sand) -> None:
    """Starts from the keyframe, lifts and throws the model as asked."""
    start_from(model, data, drop.keyframe)
    if drop.state is not None:
        if len(drop.state) != model.nq + model.nv:
            raise InputError(
                f"the state to start from has {len(drop.state)} numbers, the model has "
                f"{model.nq} positions and {model.nv} velocities"
            )
        data.qpos[:], data.qvel[:] = drop.state[: model.nq], drop.state[model.nq :]
    if drop.height is None and drop.velocity == 0.0:
        return
    roots = _vertical_dofs(model)
    if not roots:
        raise InputError(
            "the model has no free joint and no vertical slide at its root: it can be neither "
            "lifted (--height) nor thrown (--velocity); start from a keyframe instead"
        )
    for position, velocity, sign in roots:
        data.qvel[velocity] -= sign * drop.velocity
        if drop.height is not None:
            # Once is exact for a level surface; along a slope depth grows with its cosine.
            for _ in range(8):
                depth = max(body.depth for body in sand.report(data).bodies)
                data.qpos[position] += sign * (drop.height + depth)


def _vertical_dofs(model: mujoco.MjModel) -> list[tuple[int, int, float]]:
    """For each root body that can go up and down: index in qpos, in qvel, and the sense of up."""
    found = []
    for joint in range(model.njnt):
        body = int(model.jnt_bodyid[joint])
        if model.body_parentid[body] != 0:
            continue
        position, velocity = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            found.append((position + 2, velocity + 2, 1.0))
        elif model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE:
            up = float(model.jnt_axis[joint][2])
            if abs(up) > 0.999:
                found.append((position, velocity, math.copysign(1.0, up)))
    return found


def _result(
    drop: Drop,
    xml: str,
    sand: Sand,
    rows: np.ndarray,
    energy: np.ndarray,
    stop: tuple[float, float] | None,
    rest: float | None,
    prints: Prints | None,
    felt: Mapping[float, tuple[BodyReport, ...]],
) -> DropResult:
    """Works out from samples of the state what the sand did.

    What sand that remembers does follows from more than a sample: that is in `felt`, by times.
    """
    model = sand.model
    data = mujoco.MjData(model)
    t, qpos, qvel = rows[:, 0], rows[:, 1 : 1 + model.nq], rows[:, 1 + model.nq :]
    reports = []
    for row in rows:
        data.qpos[:] = row[1 : 1 + model.nq]
        data.qvel[:] = row[1 + model.nq :]
        seen = felt.get(float(row[0]))
        reports.append(sand.report(data).bodies if seen is None else seen)
    depth = np.array([[body.depth for body in bodies] for bodies in reports])
    point = np.array([[body.point for body in bodies] for bodies in reports])
    force = np.array([[body.force for body in bodies] for bodies in reports])
    power = np.array([[body.power for body in bodies] for bodies in reports])
    summaries = []
    for k, body in enumerate(reports[0]):
        mine = [bodies[k] for bodies in reports if bodies[k].depth > 0]
        exceeded: dict[str, float] = {}
        for report in mine:
            for standing in report.validity:
                if not standing.holds and standing.value is not None:
                    measure = standing.limit.measure
                    exceeded[measure] = max(exceeded.get(measure, 0.0), standing.value)
        summaries.append(
            BodySummary(
                body=body.body,
                greatest_depth=float(depth[:, k].max()),
                greatest_force=float(np.linalg.norm(force[:, k], axis=1).max()),
                energy_into_sand=float(energy[k]),
                within_validity=sum(r.valid for r in mine) / len(mine) if mine else None,
                exceeded=exceeded,
            )
        )
    return DropResult(
        drop=drop,
        xml=xml,
        medium=drop.medium or sand.medium.name,
        law=drop.law or sand.law.name,
        scheme=sand.scheme.name,
        timestep=float(model.opt.timestep),
        elements=len(sand.elements),
        stop=stop,
        rest=rest,
        bodies=tuple(summaries),
        t=t,
        qpos=qpos,
        qvel=qvel,
        depth=depth,
        point=point,
        force=force,
        power=power,
        prints=prints,
    )
