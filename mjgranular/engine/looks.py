"""How sand is drawn: fields of a block's header, for the plugin and for scenes of Python."""

from typing import Any, cast

import mujoco
import numpy as np

from mjgranular.engine.block import HEADER_DTYPE, header_at
from mjgranular.engine.draw import add_prints, add_surface, lay_prints
from mjgranular.errors import InputError
from mjgranular.kernel.compiled import compiled, entry, program_address
from mjgranular.kernel.engine import check_layout, offset_of, record_of
from mjgranular.kernel.memory import row_of
from mjgranular.kernel.vector import read_vector
from mjgranular.relief.memory import Memory
from mjgranular.relief.relief import Relief
from mjgranular.render.material import (
    COLOR,
    MATERIAL,
    NOT_SHOWN,
    TILE,
    TILES,
    ground_at,
    texture_of,
)
from mjgranular.render.skin import skin_of
from mjgranular.render.track_kernel import SIGNATURE, Region, make_canvas, shape_of
from mjgranular.surface import HeightField, Plane, Surface

_HAIR = 2e-3  # of the radius: ground of the model this near hides the sand


def look_of_plane(model: mujoco.MjModel, surface: Surface, radius: float) -> dict[str, Any] | None:
    """Return how a plane of sand is drawn under a model; None if its own geom draws the surface.

    A ball of that radius [m] around what moves sets the size of visible grains.
    """
    if not isinstance(surface, Plane):
        return None
    names = (model.material(number).name for number in range(model.nmat))
    material = next((k for k, name in enumerate(names) if name.endswith(MATERIAL)), -1)
    hair = _HAIR * radius
    ground = ground_at(model, surface.normal, surface.offset, hair)
    if any(not (model.geom_contype[geom] or model.geom_conaffinity[geom]) for geom in ground):
        return None
    return {
        "material": material,
        "picture": texture_of(model, material),
        "rgb": COLOR[:3] if material < 0 else (1.0, 1.0, 1.0),
        "unit": 2 * radius,
        "lowered": hair if ground else 0.0,  # rectangles are that far below the surface [m]
        "tiles": TILES.ctypes.data,
        "tile_count": len(TILES),
    }


def look_of_tracks(
    model: mujoco.MjModel,
    relief: Relief,
    record: np.ndarray,
    skin: int,
    unit: float,
    region: Region | None = None,
) -> tuple[dict[str, Any], tuple[np.ndarray, ...]]:
    """Return how sand with tracks is drawn, by a skin, and the arrays that this takes.

    `record` is that of the relief, `unit` the edge of the grain texture on a plane, and of
    rectangles far away [m]; a `region` of None is everything.
    """
    if region is None and not isinstance(relief.base, Plane):
        unit = TILE
    canvas, *arrays = make_canvas(record, relief.memory, unit, region)
    if canvas["vertex_count"][0] != model.skin_vertnum[skin]:
        raise InputError("skin mjgranular_prints is of another memory: delete it from the model")
    shape, fields = shape_of(relief, record["base"].dtype), cast(Any, record.dtype.fields)
    material = int(model.skin_matid[skin])
    ground = relief.base.geoms(model)[0] if isinstance(relief.base, HeightField) else -1
    return {
        "frame": fields["origin"][1],
        "shape_program": program_address(shape, SIGNATURE, "prints, as they are drawn"),
        "skin": skin,
        "skin_pointer": offset_of("mjModel", "skin_vert"),
        "skin_offset": 12 * int(model.skin_vertadr[skin]),
        "material": material,
        "picture": texture_of(model, material),
        "rgb": model.skin_rgba[skin, :3],
        "unit": unit,
        "ground": ground,
        "ground_data": model.geom_dataid[ground] if ground >= 0 else 0,
    }, (canvas, *arrays)


@compiled
def lay(block, surface, middle, model):
    """Fit the skin of a header at an address to its sand."""
    lay_prints(header_at(block), surface, read_vector(row_of(middle, 0, 3), 0), model)
    return 0


@compiled
def show(scene, block, surface, middle):
    """Add the sand of a header at an address to a scene."""
    header = header_at(block)
    if header.canvas != 0:
        add_prints(scene, header)
    else:
        add_surface(scene, header, surface, read_vector(row_of(middle, 0, 3), 0))
    return 0


class DrawnSand:
    """Sand in scenes that Python draws, by the code of the plugin.

    With a memory the model needs a skin (`add_skin`), whose vertices are written, and a surface's
    own geom is hidden. `radius` is that of what moves [m], `unit` is as for `look_of_tracks`.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        surface: Surface,
        memory: Memory | None = None,
        *,
        radius: float = 0.0,
        unit: float = 0.0,
        region: Region | None = None,
    ) -> None:
        check_layout("mjvGeom")
        self._model, self._middle = model, np.zeros(3)
        self._scene, self._head = (np.zeros(1, kind) for kind in (_SCENE, HEADER_DTYPE))
        if memory is None:
            self._record, look = surface.record(model), look_of_plane(model, surface, radius)
        else:
            # Drawings do not depend on the surroundings.
            relief = Relief(surface, memory, memory.surroundings or memory.cell)
            self._record = record = relief.record(model)
            look, self._arrays = look_of_tracks(model, relief, record, skin_of(model), unit, region)
            look["canvas"] = self._arrays[0].ctypes.data
            model.geom_group[list(surface.geoms(model))] = NOT_SHOWN
        self._is_seen = look is not None
        for name, value in (look or {}).items():
            self._head[name] = value
        self._lay = entry(lay, "int64(int64, int64, int64, int64)")
        self._show = entry(show, "int64(int64, int64, int64, int64)")

    def lay(self, state: np.ndarray, middle: np.ndarray) -> None:
        """Fit the skin to the state of a memory; call it before a scene is updated."""
        self._record["state"], self._middle[:] = state.ctypes.data, middle
        head, record, place = (a.ctypes.data for a in (self._head, self._record, self._middle))
        self._lay(head, record, place, self._model._address)

    def show(self, scene: mujoco.MjvScene, middle: np.ndarray | None = None) -> None:
        """Add the sand to a scene, a plane around a point; call it after the scene is updated."""
        if not self._is_seen:
            return
        self._middle[:] = self._middle if middle is None else middle
        self._scene["maxgeom"], self._scene["ngeom"] = scene.maxgeom, scene.ngeom
        self._scene["geoms"] = scene.geoms[0].pos.ctypes.data - offset_of("mjvGeom", "pos")
        arrays = (self._scene, self._head, self._record, self._middle)
        self._show(*(array.ctypes.data for array in arrays))
        scene.ngeom = int(self._scene["ngeom"][0])


_SCENE = record_of("mjvScene")
