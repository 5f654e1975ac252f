"""Sand in plain values, and ground that is part of a user's model."""

from dataclasses import dataclass

import mujoco

from mjgranular.errors import FloorWarning, InputError, warn_user
from mjgranular.render.material import NOT_SHOWN
from mjgranular.sand.prepare import geoms_in_sand
from mjgranular.sand.spec import SandSpec
from mjgranular.shape.select import find_all
from mjgranular.surface import Bed, HeightField, Plane, Surface, surface_of
from mjgranular.surface.floors import CARRIES, WOULD_CARRY, FloorWatch, describe_floors, find_floors
from mjgranular.surface.place import replace_geoms


@dataclass(frozen=True, kw_only=True)
class PlainSand:
    """A `SandSpec` in plain values, SI units and radians, as folders of results have it.

    None and `()` select the default. The command line shows these descriptions too.

    Attributes:
        medium: name of the sand, see `mjgranular list media`, or a YAML file. Default:
            by the law, or quikrete_medium.
        law: the force law, see `mjgranular list laws`. "rft3d scale=1.3" has other parameters than
            the medium, my_laws:Mud is a custom law. Default: the medium's.
        scheme: how forces become a step.
        surface_height: height of the surface above the world's origin [m].
        slope: slope of the surface [rad].
        uphill: direction of steepest ascent from the x axis [rad].
        bed: name of a box geom of the model that is the sand.
        height_field: name of an hfield geom of the model that is the sand.
        bodies: bodies that meet the sand, by name or number. Default: all that can move.
        geoms: geoms that meet the sand, by name or number, visual or not; `all` is all that
            collide. Bodies, geoms and groups are combined.
        groups: geom groups whose collision geoms meet the sand; of a group of visual ones, all.
        resolution: how finely bodies are cut into elements. Default: the law's.
        instead_of: geoms that the sand replaces, such as a floor that would carry the model.
        memory: side of a cell [m], or words such as "cell=0.01 extent=4", for sand that keeps
            tracks. Default: it closes behind a body.
        keep_floor: let the model stand on its own ground at or above the surface of the sand.
    """

    medium: str | None = None
    law: str | None = None
    scheme: str = "auto"
    surface_height: float = 0.0
    slope: float = 0.0
    uphill: float = 0.0
    bed: str | None = None
    height_field: str | None = None
    bodies: tuple[str, ...] = ()
    geoms: tuple[str, ...] = ()
    groups: tuple[int, ...] = ()
    resolution: int | None = None
    instead_of: tuple[str, ...] = ()
    memory: str | None = None
    keep_floor: bool = False

    def __post_init__(self) -> None:
        if self.bed is not None and self.height_field is not None:
            raise InputError("the sand is either a bed or a height field, not both")
        own = "--bed" if self.bed is not None else "--height-field"
        if self.bed is not None or self.height_field is not None:
            for name in ("surface_height", "slope", "uphill"):
                if getattr(self, name) != 0.0:
                    option = f"--{name.replace('_', '-')}"
                    raise InputError(f"{own} has its geom's pose: {option} is for a plane; omit it")
        elif self.uphill != 0.0 and self.slope == 0.0:
            raise InputError("--uphill is the direction of a slope: add --slope")
        _ = self.surface

    @property
    def surface(self) -> Surface:
        if self.bed is not None:
            return Bed(self.bed)
        if self.height_field is not None:
            return HeightField(self.height_field)
        return Plane(self.surface_height, self.slope, self.uphill)

    @property
    def sand(self) -> SandSpec:
        """The sand as `Sand` and `add_sand` take it."""
        same = ("medium", "law", "scheme", "resolution", "instead_of", "memory")
        chosen = {name: getattr(self, name) or None for name in ("bodies", "geoms", "groups")}
        others = {name: getattr(self, name) for name in same}
        return SandSpec(surface=self.surface, **chosen, **others)


def hide_replaced(model: mujoco.MjModel, sand: SandSpec) -> None:
    """Hide geoms that the sand replaces in viewers and films."""
    model.geom_group[find_all(model, "geom", sand.instead_of)] = NOT_SHOWN


def refuse_floors(model: mujoco.MjModel, sand: SandSpec) -> None:
    """Check that no ground of the model carries it at or above the sand's surface.

    Contacts of geoms that the sand replaces are switched off in the model.
    """
    replace_geoms(model, sand.instead_of)
    if floors := find_floors(model, geoms_in_sand(model, sand), surface_of(sand.surface)):
        raise InputError(_about(model, floors, WOULD_CARRY))


def warn_of_carrying(model: mujoco.MjModel, watch: FloorWatch) -> None:
    """Warn at the end of a run if ground of the model has carried it."""
    if floors := sorted(watch.floors):
        warn_user(_about(model, floors, CARRIES), FloorWarning)


def _about(model: mujoco.MjModel, floors: list[int], what: str) -> str:
    names = " ".join(model.geom(geom).name or str(geom) for geom in floors)
    return (
        f"{describe_floors(model, floors, what)}: let the sand replace it with --instead-of "
        f"{names}, or say --keep-floor if it is to stand on that"
    )
