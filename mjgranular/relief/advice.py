"""What a memory cannot show: geoms, ground and starts that do not go with its cells, in words."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from mjgranular.errors import warn_user
from mjgranular.relief.memory import Memory
from mjgranular.relief.relief import frame_of
from mjgranular.shape.sizes import geom_name, geom_width, half_extents
from mjgranular.surface import Bed, HeightField, Surface

_SEVERAL = 4
"""Cells to the width of what is to be told apart. Chosen."""


def warn_of_cells(
    model: mujoco.MjModel, geoms: Sequence[int], surface: Surface, memory: Memory
) -> None:
    """Warns of geoms, beds and height fields that are finer than cells.

    Args:
        model: the model.
        geoms: ids of those that meet the sand.
        surface: without memory.
        memory: its memory.

    Warns:
        GranularWarning: names both sizes.
    """
    cell, cells = memory.cell, f"the memory's cells of {1e3 * memory.cell:g} mm"
    widths = {geom: geom_width(model, geom) for geom in geoms}
    narrow = min(geoms, key=lambda geom: widths[geom])
    if widths[narrow] < cell * (1 - 1e-9):
        warn_user(
            f"{cells} are larger than geom {geom_name(model, narrow)}, which is "
            f"{1e3 * widths[narrow]:.3g} mm wide: its print is a cell; take cells of "
            f"{1e3 * widths[narrow] / _SEVERAL:.2g} mm"
        )
    if isinstance(surface, HeightField):
        field = surface.record(model)[0]
        apart = 2 * min(
            field["half_x"] / (field["columns"] - 1), field["half_y"] / (field["rows"] - 1)
        )
        if apart < cell * (1 - 1e-9):
            warn_user(
                f"{cells} are larger than those of the height field {surface.geom!r}, whose points "
                f"are {1e3 * apart:.3g} mm apart: sand flows as if its heights between cells were "
                f"not there; take cells of {1e3 * apart:.3g} mm"
            )
    if isinstance(surface, Bed):
        bed = surface.record(model)[0]
        side = 2 * min(bed["half_along"], bed["half_across"])
        if side < _SEVERAL * cell * (1 - 1e-9):
            warn_user(
                f"{cells} are too large for the bed {surface.geom!r}, which is {1e3 * side:.3g} mm "
                f"wide: no print fits in; take cells of {1e3 * side / (5 * _SEVERAL):.2g} mm"
            )


def warn_of_buried(
    model: mujoco.MjModel, geoms: Sequence[int], surface: Surface, memory: Memory
) -> None:
    """Warns of a geom that starts wholly under the sand, where the model stands at qpos0.

    Args:
        model: the model.
        geoms: ids of those that meet the sand.
        surface: without memory.
        memory: its memory.

    Warns:
        GranularWarning: names the geom and how deep it is.
    """
    if isinstance(surface, HeightField):
        return  # its heights may come later
    frame = frame_of(surface, surface.record(model)[0])
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    deepest, depth = -1, memory.cell
    for geom in geoms:
        place = data.geom_xpos[geom] - frame["origin"]
        axes = data.geom_xmat[geom].reshape(3, 3)
        top = place @ frame["normal"] + np.abs(frame["normal"] @ axes) @ half_extents(model, geom)
        beside = abs(place @ frame["along"]) > frame["half_along"] or (
            abs(place @ frame["across"]) > frame["half_across"]
        )
        if -top > depth and not beside:
            deepest, depth = geom, float(-top)
    if deepest >= 0:
        warn_user(
            f"geom {geom_name(model, deepest)} starts {1e3 * depth:.3g} mm and more under the "
            "sand, with the model as it stands (qpos0): memory has one height for each place, and "
            "opens a pit above what is buried; leave memory out for what swims"
        )
