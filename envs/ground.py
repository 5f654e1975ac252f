"""Sand in place of a model's floor, with sensors for environments."""

import math
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from numbers import Real
from typing import Any

import mujoco
import numpy as np

from mjgranular import Bed, HeightField, InputError, Plane, SandSpec, Surface, add_sand
from mjgranular.engine.config import SENSOR
from mjgranular.errors import loading, shown
from mjgranular.relief.memory import as_memory
from mjgranular.render.material import NOT_SHOWN, TILE, add_material
from mjgranular.render.scenery import add_daylight, place_sun
from mjgranular.sand.prepare import fitted
from mjgranular.sand.spec import combined
from mjgranular.shape.select import names_in
from mjgranular.surface import surface_of

RIGID = "mjgranular rigid ground"
"""Name of a geom that carries the robot on purpose, beside the sand."""
_BESIDE = "mjgranular sand"
_REACH = 1000.0  # half the width of each [m]; chosen: more than a cheetah runs in an episode
_CONTACT = (
    "contype", "conaffinity", "condim", "priority", "friction", "solmix", "solref", "solimp",
    "margin", "gap", "adhesion", "surfacevel",
)  # fmt: skip


def put_on_sand(
    spec: mujoco.MjSpec,
    sands: Sequence[SandSpec],
    *,
    rigid: float | None = None,
    sensors: bool = True,
    tunable: bool = False,
    cut: float = 0.0,
    tile: float = TILE,
) -> mujoco.MjModel:
    """Disable the floor's contacts, and add sand with sensors.

    Other changes: RK4 becomes the implicit-fast integrator, because sand that holds bodies at rest
    does not act within a step of RK4; a fluid that fills the world is removed; the floor is
    rendered as sand, or hidden if the sand is not a plane; a sun and a sky replace the model's. If
    no geom of the robot makes contacts, as in a swimmer, all of them meet the sand.

    Args:
        spec: the model to be; it is changed.
        sands: one or several, with the instances `sand`, `sand_2`, ...; without a surface a sand is
            the level plane where the floor was.
        rigid: the x up to which the floor stays [m], level sand beyond; None for sand everywhere.
        sensors: whether to add sensors of the sand to the model (`envs.figures`).
        tunable: whether instances can be tuned at run time.
        cut: depth at which a plane of sand without memory is rendered, to show what is buried [m].
        tile: edge length of the ground's texture [m].
    """
    placed = place(spec, sands, rigid=rigid, cut=cut, tile=tile)
    names, bare = [], spec.copy()
    for sand in placed:
        if as_memory(sand.memory) is not None:
            with quiet():
                sand = fitted(bare.compile(), sand)
        # Sand with memory renders itself, at its true height.
        draw = () if as_memory(sand.memory) is None else ("surface",)
        names.append(add_sand(spec, sand, tunable=tunable, draw=draw).name)
    if sensors:
        _add_sensors(spec, names)
    with quiet(), loading("the robot"):
        model = spec.compile()
    place_sun(model)
    return model


def place(
    spec: mujoco.MjSpec,
    sands: Sequence[SandSpec],
    *,
    rigid: float | None = None,
    cut: float = 0.0,
    tile: float = TILE,
) -> list[SandSpec]:
    """Prepare a model for sand in place of its floor; see `put_on_sand` for the changes.

    Return the sands with their surfaces, and with the floors that they replace.
    """
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    floors = [geom for geom in spec.worldbody.geoms if geom.type == plane]
    _give_names(floors, "mjgranular_floor", spec.geoms)
    bare = _without_dunes(spec)
    spec.stat.extent, spec.stat.center = bare.stat.extent, bare.stat.center  # near and far planes
    if spec.option.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.density = spec.option.viscosity = 0.0
    parts = [geom for body in spec.bodies[1:] for geom in body.geoms]
    if not any(geom.contype or geom.conaffinity for geom in parts):
        for geom in parts:  # contacts with others, but not with each other
            geom.conaffinity = 1
    if rigid not in (None, -math.inf):
        if not floors or cut or any(sand.surface for sand in sands):
            raise InputError(
                "rigid needs a floor in the model, level sand, and a robot that stands on it: "
                "omit surface and dunes, or rigid"
            )
        solid = [floor for floor in floors if floor.contype or floor.conaffinity] or floors
        highest = max(solid, key=lambda floor: bare.geom(floor.name).pos[2])
        _add_rigid_ground(spec, highest, _surface_of(bare, solid).height, rigid)
        surfaces: list[Surface] = [Bed(_BESIDE) for _ in sands]
    else:
        surfaces = [
            surface_of(sand.surface) if sand.surface else _surface_of(bare, floors)
            for sand in sands
        ]
    add_daylight(spec)
    _paint(spec, floors, surfaces, cut, tile)
    _give_names(spec.bodies, "body", spec.bodies)  # sensors find bodies by name
    replaced = [floor.name for floor in floors]
    return [
        combined(sand, {"surface": surface, "instead_of": [*replaced, *names_in(sand.instead_of)]})
        for sand, surface in zip(sands, surfaces, strict=True)
    ]


@contextmanager
def quiet() -> Iterator[None]:
    """Ignore warnings of a deprecated attribute, robots buried until a reset, and rigid ground."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="compiler attribute 'settotalmass'")
        warnings.filterwarnings("ignore", message="robot .* is buried")
        warnings.filterwarnings("ignore", message=f"the model's own geom '{RIGID}'")
        yield


def _without_dunes(spec: mujoco.MjSpec) -> mujoco.MjModel:
    bare = spec.copy()
    for geom in bare.worldbody.geoms:
        if geom.type == mujoco.mjtGeom.mjGEOM_HFIELD:
            bare.delete(geom)
    with quiet(), loading("the robot"):
        return bare.compile()


def _give_names(elements: Sequence[Any], stem: str, same_kind: Sequence[Any]) -> None:
    """Name elements without a name by their number; `same_kind` has all names that are taken."""
    taken = {element.name for element in same_kind}
    for number, element in enumerate(elements):
        name = f"{stem}_{number}"
        while name in taken:
            name += "_"
        element.name = element.name or name


def _add_rigid_ground(
    spec: mujoco.MjSpec, floor: mujoco.MjsGeom, height: float, end: float
) -> None:
    """Add a block with the contacts of the floor up to x = `end`, then a bed of sand."""
    real = isinstance(end, Real) and not isinstance(end, bool)
    if not real or not (abs(end) < _REACH or end == math.inf):
        raise InputError(
            f"rigid must be where the rigid floor ends, within {_REACH:g} m, or inf, not "
            f"{shown(end)}"
        )
    box, cube = mujoco.mjtGeom.mjGEOM_BOX, [_REACH] * 3
    sand = spec.worldbody.add_geom(name=_BESIDE, type=box, size=cube)
    rigid = spec.worldbody.add_geom(name=RIGID, type=box, size=cube)
    sand.contype = sand.conaffinity = 0
    rigid.material, rigid.rgba = "", [0.45, 0.47, 0.5, 1]
    for name in _CONTACT:
        setattr(rigid, name, getattr(floor, name))
    if end == math.inf:  # contacts as on the floor, to the last bit, and sand out of reach
        rigid.type = floor.type
        rigid.pos, sand.pos = [0, 0, height], [0, 0, height - 2 * _REACH]
    else:
        for geom, x in ((sand, end + _REACH), (rigid, end - _REACH)):
            geom.pos = [x, 0, height - _REACH]


def _surface_of(model: mujoco.MjModel, floors: Sequence[mujoco.MjsGeom]) -> Plane:
    """Return the level plane at the height of the floor."""
    if not floors:
        raise InputError("the model has no floor (a plane geom of the world): give a surface=...")
    placed = [model.geom(floor.name) for floor in floors]
    for floor in placed:
        if np.hypot(*floor.quat[1:3]) > 1e-9:
            raise InputError(f"the floor {floor.name!r} is not level: give a surface=Plane(...)")
    return Plane(height=max(float(floor.pos[2]) for floor in placed))


def _paint(
    spec: mujoco.MjSpec,
    floors: Sequence[mujoco.MjsGeom],
    surfaces: Sequence[Surface],
    cut: float,
    tile: float,
) -> None:
    """Make floors look like sand, and move them to its height."""
    material = add_material(spec, tile=tile)
    for surface in surfaces:
        if isinstance(surface, Bed | HeightField):
            geom = spec.geom(surface.geom)
            if geom is not None:
                geom.material = material
                geom.rgba = [1, 1, 1, 1]
    plane = next((surface for surface in surfaces if isinstance(surface, Plane)), None)
    for floor in floors:
        if plane is None:
            floor.group = NOT_SHOWN
            continue
        floor.material = material
        floor.rgba = [1, 1, 1, 1]
        floor.set_frame(spec.worldbody.add_frame())  # its own may be moved or turned
        floor.pos = [0, 0, plane.height - cut]
        half = plane.slope / 2
        axis = (math.sin(plane.uphill), -math.cos(plane.uphill))
        floor.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT  # else an euler angle counts
        floor.quat = [math.cos(half), axis[0] * math.sin(half), axis[1] * math.sin(half), 0]


def _add_sensors(spec: mujoco.MjSpec, names: Sequence[str]) -> None:
    """Add sensors of all bodies together, those of a sand after each other (`envs.figures`)."""
    spec.activate_plugin(SENSOR)
    for instance in names:
        for measure in ("force", "depth", "power", "speed"):
            plugin = spec.add_plugin(
                name=f"{measure} of {instance}", plugin_name=SENSOR, active=True
            )
            plugin.config = {"measure": measure, "sand": instance}
            name = f"sand/{measure}/{instance}"
            sensor = spec.add_sensor(name=name, type=mujoco.mjtSensor.mjSENS_PLUGIN)
            sensor.plugin.active = True
            sensor.plugin.plugin_name, sensor.plugin.name = SENSOR, plugin.name


DUNES = "dunes"  # name of the geom and of its height field

_WAVES = ((1.0, 0.0, 0.0), (0.45, 0.8, 1.1), (0.3, -1.3, 2.3))
"""Share of the height, waves along y per wave along x, phase; chosen: ridges that meander."""


@dataclass(frozen=True)
class Dunes:
    """Three sine waves, the longest of them across the x axis; always the same.

    They are as high as their steepest slope allows; laws are valid to ten degrees (`docs/laws`).
    """

    wavelength: float = 4.0  # wavelength of the longest [m]
    extent: float = 40.0  # half size of the dunes along x and y [m]
    steepest: float = math.radians(9)  # steepest slope [rad]; chosen

    def height(self, x: float, y: float) -> float:
        """Return the height over the level ground at a point [m]."""
        return self._wave(math.sin, x, y)

    def _wave(self, sin: Any, x: Any, y: Any) -> Any:
        k = 2 * math.pi / self.wavelength
        slopes = sum(share * k * math.hypot(1.0, across) for share, across, _ in _WAVES)
        waves = (share * sin(k * (x + across * y) + phase) for share, across, phase in _WAVES)
        return math.tan(self.steepest) / slopes * sum(waves)  # no slope exceeds `steepest`

    def heights(self) -> np.ndarray:
        """Return heights on the height field's grid [m], shape (rows over y, columns over x)."""
        count = 2 * round(20 * self.extent / self.wavelength) + 1
        line = np.linspace(-self.extent, self.extent, count)
        return self._wave(np.sin, line[None, :], line[:, None])


def add_dunes(spec: mujoco.MjSpec, dunes: Dunes) -> None:
    """Add dunes around the height of the model's floor."""
    heights = dunes.heights()
    low, high = float(heights.min()), float(heights.max())
    field = spec.add_hfield(name=DUNES)
    field.nrow, field.ncol = heights.shape
    field.size = [dunes.extent, dunes.extent, high - low, 0.1]
    field.userdata = ((heights - low) / (high - low)).ravel().tolist()
    floor = max(
        (float(g.pos[2]) for g in spec.worldbody.geoms if g.type == mujoco.mjtGeom.mjGEOM_PLANE),
        default=0.0,
    )
    spec.worldbody.add_geom(
        name=DUNES,
        type=mujoco.mjtGeom.mjGEOM_HFIELD,
        hfieldname=DUNES,
        pos=[0, 0, floor + low],
        contype=0,
        conaffinity=0,
    )
