"""Sand with tracks in a scene that Python draws; the plugin draws it in compiled code."""

from typing import Any

import mujoco
import numpy as np

from mjgranular.kernel.compiled import entry
from mjgranular.relief.memory import Memory
from mjgranular.relief.relief import Relief
from mjgranular.render.material import NOT_SHOWN, add_geom, texture_of
from mjgranular.render.skin import lines_of, skin_of, stride_of, vertex_count
from mjgranular.render.track_kernel import BLOCK, CANVAS_DTYPE, room_for, shape_of
from mjgranular.surface import HeightField, Surface

SIGNATURE = "int64(int64, float64)"
"""Signature of the program that fits a skin to the sand."""


Region = tuple[np.ndarray, np.ndarray, float]
"""A rectangle of sand along the axes of the plane under the heights: its lowest and highest corner,
and the lower edge of its walls, over the plane; 0 for none [m]."""


def make_canvas(
    record: np.ndarray, memory: Memory, unit: float, region: Region | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the description of a drawing, `CANVAS_DTYPE` of shape (1,), its blocks and rectangles.

    The addresses of surface and vertices are missing.
    """
    if region is None and np.isfinite(record["half_along"][0]):
        half = np.array([record["half_along"][0], record["half_across"][0]])
        names = record["base"].dtype.names or ()
        thick = float(record["base"]["thickness"][0]) if "thickness" in names else 0.0
        region = -half, half, -thick
    lines = lines_of(memory)
    canvas = np.zeros(1, CANVAS_DTYPE)
    canvas["lines"], canvas["vertex_count"] = lines, vertex_count(lines)
    canvas["stride"] = stride_of(memory)
    canvas["room"], canvas["unit"] = room_for(lines), unit
    if region is not None:
        low, high, bottom = region
        canvas["bounded"], canvas["low"], canvas["high"] = 1, low, high
        canvas["bottom"], canvas["middle"] = bottom, (low + high) / 2
        canvas["held"] = (high - low).max() < (lines - 4 * BLOCK) * stride_of(memory) * memory.cell
    blocks, rectangles = np.zeros((lines // BLOCK) ** 2, np.int64), np.zeros(4 * room_for(lines))
    canvas["blocks"], canvas["rectangles"] = blocks.ctypes.data, rectangles.ctypes.data
    return canvas, blocks, rectangles


class TrackMesh:
    """Sand with tracks, in a model that has a skin for it (`add_skin`), whose vertices are written.

    `base` is the surface without tracks, `unit` the edge of the grain texture, and of rectangles
    far away [m]; a `region` of None is everything.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        base: Surface,
        memory: Memory,
        *,
        unit: float,
        region: Region | None = None,
    ) -> None:
        # Drawings do not depend on the surroundings.
        relief = Relief(base, memory, memory.surroundings or memory.cell)
        self._record = record = relief.record(model)
        self._shape = entry(shape_of(relief, record["base"].dtype), SIGNATURE)
        self._skin, self._unit = skin_of(model), unit
        canvas, self._blocks, rectangles = make_canvas(record, memory, unit, region)
        self._canvas = canvas
        self._rectangles = rectangles.reshape(-1, 4)
        first = int(model.skin_vertadr[self._skin])
        self._vertices = model.skin_vert[first : first + int(canvas["vertex_count"][0])]
        canvas["surface"], canvas["vertices"] = record.ctypes.data, self._vertices.ctypes.data
        self._model = model
        self._field = base.geoms(model)[0] if isinstance(base, HeightField) else -1
        for geom in base.geoms(model):
            model.geom_group[geom] = NOT_SHOWN

    def lay(self, state: np.ndarray, middle: np.ndarray) -> None:
        """Fit the skin to the sand; call it before a scene is updated."""
        canvas, record = self._canvas[0], self._record[0]
        if not canvas["held"]:
            away = middle - record["origin"]
            canvas["middle"] = away @ record["along"], away @ record["across"]
        record["state"] = state.ctypes.data
        self._shape(self._canvas.ctypes.data, 0.0)

    def show(self, scene: mujoco.MjvScene) -> None:
        """Add skin and rectangles to a scene; call it after it is updated."""
        record = self._record[0]
        axes = np.column_stack([record[name] for name in ("along", "across", "normal")])
        skin, nothing = mujoco.mjtGeom.mjGEOM_SKIN, np.zeros(3)
        geom = self._add(scene, skin, nothing, nothing, np.eye(3))
        if geom is not None:
            geom.objtype, geom.objid = mujoco.mjtObj.mjOBJ_SKIN, self._skin
            geom.texuniform, geom.texcoord = 0, 1
            geom.texrepeat = [1 / self._unit, 1 / self._unit]
        if self._field >= 0 and not self._canvas["held"][0]:
            place = record["origin"] + self._canvas["sunk"][0] * axes[:, 2]
            geom = self._add(scene, mujoco.mjtGeom.mjGEOM_HFIELD, nothing, place, axes)
            if geom is not None:
                geom.dataid = self._model.geom_dataid[self._field]
        for u, v, half_u, half_v in self._rectangles[: int(self._canvas["count"][0])]:
            place = record["origin"] + axes @ [u, v, 0.0]
            size = np.array([half_u, half_v, 0.1])
            self._add(scene, mujoco.mjtGeom.mjGEOM_PLANE, size, place, axes)

    def _add(self, scene: mujoco.MjvScene, *shape: Any) -> Any:
        """Add a geom to a scene with the material of the skin; return None if the scene is full."""
        model, material = self._model, int(self._model.skin_matid[self._skin])
        return add_geom(
            scene,
            *shape,
            material=material,
            texture=texture_of(model, material),
            rgba=np.append(model.skin_rgba[self._skin, :3], np.float32(1.0)),
            unit=self._unit,
        )
