"""Warnings: what can be computed, but was most likely not intended.

A check yields sentences about a model and its sand. The tables at the end give each its warning.
Limits without a source are chosen.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from mjgranular import errors
from mjgranular.errors import listed, warn_user
from mjgranular.law import DepthVelocityLaw, DistributedLinkLaw, Law, LinkLaw
from mjgranular.law.rft import RftLaw
from mjgranular.medium.medium import DENSITIES
from mjgranular.relief.memory import REPOSE, Memory
from mjgranular.relief.relief import frame_of
from mjgranular.sand.spec import DEFAULT_MEDIUM, SandSpec, law_named_in
from mjgranular.shape.select import body_name, collides, is_choice, moves
from mjgranular.shape.sizes import LARGEST, data_at_start, geom_name, half_extents, name_of
from mjgranular.surface import Bed, Plane, Surface
from mjgranular.surface.floors import CARRIES, WOULD_CARRY, FloorWatch, describe_floors, find_floors
from mjgranular.surface.place import strength_of_gravity


@dataclass(frozen=True)
class Case:
    """What is checked: a model, its sand as described, and what was resolved from that."""

    model: mujoco.MjModel
    spec: SandSpec
    geoms: Sequence[int]
    law: Law
    surface: Surface
    memory: Memory | None


def warn(checks: Iterable[tuple[Callable[..., Iterator[str]], Any]], *arguments: Any) -> None:
    """Warn of what checks yield, each with its class of warnings."""
    for check, kind in checks:
        for message in check(*arguments):
            warn_user(message, kind)


# Parts of the model that the sand ignores


def contact_sensors(case: Case) -> Iterator[str]:
    """Check that no sensor is to measure the sand by contacts; those of two bodies are not."""
    model, types = case.model, mujoco.mjtSensor
    meets, names = set(model.geom_bodyid[list(case.geoms)]), []
    objects = list(zip(model.sensor_objtype, model.sensor_objid, strict=True))
    others = list(zip(model.sensor_reftype, model.sensor_refid, strict=True))
    ours = [objects[i] for i in (model.sensor_type == types.mjSENS_PLUGIN).nonzero()[0]]
    kinds = [types.mjSENS_TOUCH, types.mjSENS_CONTACT, types.mjSENS_TACTILE]
    for sensor in np.isin(model.sensor_type, kinds).nonzero()[0]:
        first, second = (_moving_bodies(model, *end[sensor]) for end in (objects, others))
        if (first | second) & meets and not (first and second) and objects[sensor] not in ours:
            names.append(name_of(model, "sensor", int(sensor)) or f"number {sensor}")
    if names:
        yield (
            f"MuJoCo's sensors of contacts measure nothing of the sand ({listed(names)}): use the "
            "sensor mjgranular.sensor with the measure touch inside mj_step, or Sand.report"
        )


def _moving_bodies(model: mujoco.MjModel, kind: int, number: int) -> set[int]:
    """Return the bodies of a sensor's object that can move: the whole tree for a subtree."""
    roots = model.body_rootid
    bodies = {
        mujoco.mjtObj.mjOBJ_SITE: model.site_bodyid[number : number + 1],
        mujoco.mjtObj.mjOBJ_GEOM: model.geom_bodyid[number : number + 1],
        mujoco.mjtObj.mjOBJ_BODY: [number],
        mujoco.mjtObj.mjOBJ_XBODY: np.isin(roots, roots[number : number + 1]).nonzero()[0],
    }.get(mujoco.mjtObj(kind), ())
    return {int(body) for body in bodies if moves(model, int(body))}


def ignored_parts(case: Case) -> Iterator[str]:
    """Check that no flex and no geom of a mocap body is ignored, unless the user has chosen."""
    model, spec = case.model, case.spec
    if spec.groups is not None or is_choice(spec.bodies) or is_choice(spec.geoms):
        return
    for flex in range(model.nflex):
        bodies = []  # of its vertices or nodes
        for part in ("vert", "node"):
            begin, count = (getattr(model, f"flex_{part}{key}")[flex] for key in ("adr", "num"))
            bodies += getattr(model, f"flex_{part}bodyid")[begin : begin + count].tolist()
        if any(body > 0 and moves(model, body) for body in bodies):
            yield (
                f"the sand does not act on flex {name_of(model, 'flex', flex) or flex!r}: it feels "
                "geoms of rigid bodies alone; name with bodies=[...] those that meet it"
            )
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        root = int(model.body_rootid[body])
        if model.body_mocapid[root] >= 0 and collides(model, geom) and not moves(model, body):
            yield (
                f"the sand does not act on mocap body {body_name(model, root)}, to which MuJoCo "
                "gives no velocity: put its geoms on a free body and <weld> that to it, or name "
                "with bodies=[...] those that meet the sand"
            )
            return


# Ground and feet made for contacts

_REMEDY = ": name in instead_of=[...] what the sand replaces, or put that ground deeper"


def floors(case: Case) -> Iterator[str]:
    """Check that bodies will not stand on the model's own ground."""
    if found := find_floors(case.model, case.geoms, case.surface):
        yield describe_floors(case.model, found, WOULD_CARRY) + _REMEDY


def contacts(case: Case, data: mujoco.MjData) -> Iterator[str]:
    """Check that bodies do not stand on the model's own ground now."""
    watch = FloorWatch(case.model, case.geoms, case.surface)
    watch.look(data)
    if watch.floors:
        yield describe_floors(case.model, sorted(watch.floors), CARRIES) + _REMEDY


SHARE = 0.15
"""Size of a point, at most, in parts of the size of what is drawn of its body. The four spheres
under a humanoid's foot have 0.05; the smallest true foot, a ball at the end of a shin, has 0.2."""


def find_points(model: mujoco.MjModel, geoms: Sequence[int]) -> dict[int, list[int]]:
    """Find the bodies that meet the sand only with geoms small compared to what is drawn.

    Return the largest geom that is drawn of each, with those that meet the sand.
    """
    # Not `geom_rbound`, which is that from a mesh's centroid.
    sizes = [max(half_extents(model, geom)) for geom in range(model.ngeom)]
    members: dict[int, list[int]] = {}
    for geom in geoms:
        members.setdefault(int(model.geom_bodyid[geom]), []).append(geom)
    found = {}
    for body, mine in members.items():
        first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
        drawn = [g for g in range(first, first + count) if g not in mine and not collides(model, g)]
        largest = max(drawn, key=sizes.__getitem__, default=mine[0])
        if max(sizes[geom] for geom in mine) < SHARE * sizes[largest]:
            found[largest] = mine
    return found


def points(case: Case) -> Iterator[str]:
    """Check that no body has point feet, which sink; geoms named one by one are intended."""
    model, spec = case.model, case.spec
    found = find_points(model, case.geoms) if spec.geoms is None else {}
    if not found:
        return
    size = 2e3 * max(model.geom_rbound[mine].max() for mine in found.values())
    every = ["all"] if spec.bodies is None and spec.groups is None else []
    drawn = [*every, *(name_of(model, "geom", geom) or geom for geom in found)]
    yield (
        f"{listed(body_name(model, int(model.geom_bodyid[geom])) for geom in found)} "
        f"{'meets' if len(found) == 1 else 'meet'} the sand with points only, at most {size:.3g} "
        "mm wide: made for contacts with a floor, they will sink; to have what is drawn in the "
        f"sand too, take geoms={drawn} (--geoms {' '.join(map(str, drawn))})"
    )


# Values that are implausible for sand: most likely a wrong unit

_LONGEST_STEP = 0.1
"""Time step [s]. MuJoCo's own models have 1 to 10 ms; a body that falls 1 cm into sand is at rest
after 50 ms. A value in milliseconds is 1 or more."""

_DEEPEST_START = 1.0
"""Depth of the highest point of all that meets the sand [m]. A height in millimeters, or with the
wrong sign, is further off. For a robot the limit is half its largest geom."""

_WIDEST = 10.0
"""Width of a geom that meets the sand [m]: an excavator's. A geom drawn in millimeters has more."""

_STEEPEST = math.radians(75)
"""Angle between gravity and the way into a plane of sand. Sand slides from 35 degrees on; with
gravity along y it is 90."""

_ROUNDING = 1e-6  # tolerance for a slope equal to the angle of repose [rad]
_LEVEL = 1e-3  # vertical component of an axis up to which it counts as level

_STRONGEST = 100.0
"""Gravity [m/s^2]. The Sun's planets have up to 25; in centimeters it is 981."""
_BRINE = 1300.0  # density of the densest fluid that may be meant [kg/m^3]; swimmers have 4000

_OF_SAND = (LinkLaw, DistributedLinkLaw, RftLaw, DepthVelocityLaw)
"""Laws known to be of sand: a custom law may be of mud, or of a lake."""


def sizes(case: Case) -> Iterator[str]:
    """Check that geoms are not drawn in millimeters."""
    model, geoms = case.model, case.geoms
    if not (model.geom_size[list(geoms)] < LARGEST).all():
        return  # an error where the elements are made
    largest = max(geoms, key=lambda geom: model.geom_rbound[geom])
    across = 2 * float(model.geom_rbound[largest])
    if across > _WIDEST:
        yield (
            f"geom {geom_name(model, largest)} is {across:.3g} m across: lengths are in meters, "
            f"and {across:.3g} mm is {across / 1000:.3g} m"
        )


def density(case: Case) -> Iterator[str]:
    """Check the density of a law that was given its own; a medium checks that of its grains."""
    value, (low, high) = getattr(case.law, "density", None), DENSITIES
    if isinstance(value, (int, float)) and value > 0 and not low <= value <= high:
        yield (
            f"the law {case.law.name!r} has a density of {value:g} kg/m^3, and sand has {low:g} to "
            f"{high:g}: 1 g/cm^3 is 1000 kg/m^3"
        )


def timestep(case: Case) -> Iterator[str]:
    """Check the time step."""
    step = case.model.opt.timestep
    if step > _LONGEST_STEP:
        yield (
            f"the time step is {step:g} s, in which what falls is far below the sand before it "
            f"is met: {step:g} ms is {step / 1000:g} s"
        )


def gravity(case: Case) -> Iterator[str]:
    """Check the size of gravity, and that it pulls into a plane; a wall is allowed if asked for."""
    pull, strength = case.model.opt.gravity, strength_of_gravity(case.model)
    if not 0.0 < strength < _STRONGEST and isinstance(case.law, _OF_SAND):
        yield (
            f"gravity is {strength:g} m/s^2, to which what most laws hold at rest is proportional: "
            "on Earth opt.gravity is 0 0 -9.81, with lengths in meters, and no flag disables it"
        )
    if not isinstance(case.surface, Plane) or strength == 0.0:
        return
    down = min(1.0, max(-pull[2], -float(pull @ case.surface.normal)) / strength)
    off = math.acos(max(-1.0, down))
    if off > _STEEPEST:
        components = ", ".join(f"{component:g}" for component in pull)
        yield (
            f"gravity, ({components}) m/s^2, is {math.degrees(off):.0f} degrees off the way into "
            "the sand: z is up, and gravity 0 0 -9.81 on level ground"
        )


def fluid(case: Case) -> Iterator[str]:
    """Check that what swims in sand does not swim in the fluid of its model as well."""
    if case.model.opt.density > _BRINE:
        yield (
            f"a fluid of {case.model.opt.density:g} kg/m^3 fills the world, and resists in sand "
            "too: set opt.density and opt.viscosity to 0"
        )


def slope(case: Case) -> Iterator[str]:
    """Check that sand stays on a plane or bed.

    The angle of repose is the memory's, else that of the law's internal friction, else `REPOSE`.
    """
    pull = case.model.opt.gravity
    if not isinstance(case.surface, (Plane, Bed)) or pull[2] >= 0.0 or pull[:2].any():
        return
    friction = getattr(case.law, "internal_friction", None)
    repose = REPOSE if friction is None else math.atan(friction)
    if case.memory is not None:
        repose = case.memory.repose
    angle = case.surface.tilt(case.model)
    if angle > repose + _ROUNDING:
        yield (
            f"the sand slopes by {math.degrees(angle):.3g} degrees, and its angle of repose is "
            f"{math.degrees(repose):.3g}: it would flow down, and what stands on it here would not "
            "stay; slopes are in degrees on the command line and in radians elsewhere"
        )


def start(case: Case) -> Iterator[str]:
    """Check that bodies do not start too deep; with memory `buried_geoms` does."""
    if case.memory is None:
        yield from depth(case, data_at_start(case.model), "with the model as it stands (qpos0)")


def depth(case: Case, data: mujoco.MjData, when: str) -> Iterator[str]:
    """Check that bodies are not too deep in a plane of sand to be there on purpose.

    A law that is not of sand is not checked. `when` describes the positions in `data`.
    """
    model, surface = case.model, case.surface
    if not isinstance(surface, Plane) or not isinstance(case.law, _OF_SAND):
        return
    rows, normal = np.asarray(case.geoms), surface.normal
    half = [half_extents(model, geom) for geom in case.geoms]
    tops = (np.abs(normal @ data.geom_xmat[rows].reshape(-1, 3, 3)) * half).sum(axis=1)
    depths = surface.offset - data.geom_xpos[rows] @ normal - tops
    least = float(depths.min())
    if least > _DEEPEST_START:
        yield (
            f"all that meets the sand starts {least:.3g} m and more under its surface, {when}: "
            "lengths are in meters, and z is up; raise the model or lower the surface"
        )
        return
    bodies = model.geom_bodyid[rows]
    roots = model.body_rootid[bodies]
    for root in np.unique(roots):
        mine = roots == root
        least = float(depths[mine].min())
        is_robot = len(np.unique(model.body_weldid[bodies[mine]])) > 1
        is_deep = least > model.geom_rbound[rows[mine]].max()
        if is_robot and is_deep and _may_rise(model, data, root):
            yield (
                f"robot {body_name(model, int(root))} is buried {least:.3g} m and more under the "
                f"sand, {when}, and stays there: raise it, in MJCF by its pos, or lower the "
                f"surface by {least:.3g} m and more"
            )
            return


def _may_rise(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> bool:
    """Return True if a joint of the body lets it move up, unlike a swimmer in a level plane."""
    joints = model.jnt_bodyid == body
    is_slide = model.jnt_type[joints] == mujoco.mjtJoint.mjJNT_SLIDE
    is_free = model.jnt_type[joints] == mujoco.mjtJoint.mjJNT_FREE
    return bool((is_free | (is_slide & (abs(data.xaxis[joints, 2]) > _LEVEL))).any())


# The law, its cost, and its use


def link_law(case: Case) -> Iterator[str]:
    """Check that the lumped link law is meant, if only the medium has brought it."""
    named, medium = law_named_in(case.model), getattr(case.spec.medium, "name", case.spec.medium)
    if case.spec.law is None and isinstance(case.law, LinkLaw) and named != case.law.name:
        yield (
            f"medium {str(medium)!r} brings the law 'link', under which free bodies do "
            f"not come to rest: use law='link_distributed', or medium={DEFAULT_MEDIUM!r}, or say "
            "law='link' if it is meant"
        )


MANY = 20_000
"""Number of elements above which a warning is given. Chosen: with all of them in the sand a step
takes twice the two milliseconds that models of robots have for a time step."""


def cost(elements: np.ndarray) -> Iterator[str]:
    """Check that the number of elements does not make steps slow."""
    if len(elements) > MANY:
        yield (
            f"{len(elements):,} elements take milliseconds in each step: take a lower resolution, "
            "or fewer geoms"
        )


def missed_steps(
    time: float, last: float | None, step: float, began: float | None = None
) -> Iterator[str]:
    """Check that the time has not advanced without the sand.

    It last acted at `last`, None for never, in a step of this size. `began` is the initial time if
    it should act from the first step on; None if the state may come from elsewhere.
    """
    since = began if last is None else last + step
    if since is None or not time > since + 0.5 * step:
        return
    acted = "has never acted in this MjData"
    if last is not None:
        acted = f"last acted in the step from {last:.6g} s"
    yield (
        f"time is {time:.6g} s, but this sand {acted}: was mujoco.mj_step called in place of "
        "sand.step? (add_sand has sand act inside mj_step)"
    )


def buried_geoms(case: Case) -> Iterator[str]:
    """Check that no geom starts fully under sand with memory; heights may be set later."""
    model, surface, memory = case.model, case.surface, case.memory
    if memory is None or not isinstance(surface, Plane | Bed):
        return
    frame, data = frame_of(surface, surface.record(model)[0]), data_at_start(model)
    deepest, under = -1, memory.cell
    for geom in case.geoms:
        place = data.geom_xpos[geom] - frame["origin"]
        axes = data.geom_xmat[geom].reshape(3, 3)
        top = place @ frame["normal"] + np.abs(frame["normal"] @ axes) @ half_extents(model, geom)
        is_beside = any(abs(place @ frame[x]) > frame[f"half_{x}"] for x in ("along", "across"))
        if -top > under and not is_beside:
            deepest, under = geom, float(-top)
    if deepest >= 0:
        yield (
            f"geom {geom_name(model, deepest)} starts {1e3 * under:.3g} mm and more under the "
            "sand, with the model as it stands (qpos0): memory has one height for each place, and "
            "opens a pit above what is buried; omit memory for what swims"
        )


CHECKS = (
    (contact_sensors, errors.UnfeltWarning),
    (ignored_parts, errors.UnfeltWarning),
    (floors, errors.FloorWarning),
    (density, errors.RangeWarning),
    (timestep, errors.RangeWarning),
    (gravity, errors.RangeWarning),
    (fluid, errors.RangeWarning),
    (slope, errors.RangeWarning),
    (start, errors.RangeWarning),
    (sizes, errors.RangeWarning),
    (buried_geoms, errors.GranularWarning),
    (points, errors.PointsWarning),
)
"""Checks of a case, made once."""

CHECKS_OF_TIME = ((missed_steps, errors.MissedStepWarning),)
CHECKS_OF_CONTACTS = ((contacts, errors.FloorWarning),)
CHECKS_OF_DEPTH = ((depth, errors.RangeWarning),)
