"""Warn of geoms, ground and initial states that the cells of a memory cannot represent."""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np

from mjgranular.errors import InputError, warn_user
from mjgranular.relief.footprint import Footprint, spread_of
from mjgranular.relief.memory import Memory
from mjgranular.relief.relief import frame_of
from mjgranular.shape.sizes import geom_name, geom_width, half_extents
from mjgranular.surface import Bed, HeightField, Surface

_PLACES = frozenset(("center", "point", "geom", "body", "slot"))
"""Fields of elements that give their position, not their size."""

_SEVERAL = 4
"""Cells across a feature that is to be resolved. Chosen."""


def warn_of_cells(
    model: mujoco.MjModel, geoms: Sequence[int], surface: Surface, memory: Memory
) -> None:
    """Warn of geoms, beds and height fields that are finer than cells.

    Args:
        model: the model.
        geoms: ids of the geoms that meet the sand.
        surface: the surface without memory.
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


def refuse_blind(
    model: mujoco.MjModel,
    elements: np.ndarray,
    reads: Sequence[str],
    footprint: Footprint,
    memory: Memory,
    law: str,
) -> None:
    """Check that a law does not look for sand in the middle of bodies.

    The surface points of bodies press the sand down; then there is none in the middle, and the body
    would sink without limit.

    Args:
        model: the model.
        elements: elements of the law.
        reads: names of the element fields that its kernels read.
        footprint: surface points of the bodies.
        memory: memory of the sand.
        law: name of the law.

    Raises:
        InputError: names the geom, and how far inside its surface the law looks.
    """
    if not _PLACES.issuperset(reads):
        return
    points = footprint.points[:, :3].transpose(0, 2, 1)  # tile by tile
    feet = list(dict.fromkeys(elements["geom"].tolist()))
    for element in elements:
        row = feet.index(int(element["geom"]))
        first = int(footprint.feet["end"][row - 1]) if row else 0
        skin = points[first : int(footprint.feet["end"][row])].reshape(-1, 3)
        place = element["center" if "center" in reads else "point"]
        inside = float(np.linalg.norm(skin - place, axis=1).min())
        if inside > memory.cell:
            raise InputError(
                f"the law {law!r} looks for sand in the middle of geom "
                f"{geom_name(model, int(element['geom']))}, {1e3 * inside:.3g} mm inside the skin "
                "that presses it down under memory, and the body would sink without end: have the "
                "law look where the body ends (docs/architecture.md), or leave memory out"
            )


def warn_of_spread(model: mujoco.MjModel, geoms: Sequence[int], memory: Memory) -> None:
    """Warn of bodies that are farther apart than the extent of the memory.

    Args:
        model: the model.
        geoms: ids of the geoms that meet the sand.
        memory: its memory.

    Warns:
        GranularWarning: names both lengths.
    """
    spread, side = spread_of(model, geoms), memory.size * memory.cell
    if spread > side * (1 + 1e-9):
        needed = math.ceil(10 * spread) / 10
        warn_user(
            f"what meets the sand reaches over {spread:.3g} m, with the model as it stands, and a "
            f"square of {side:.3g} m is remembered, wrapped around: one writes over the prints of "
            f"another; say memory='cell={memory.cell:g} extent={needed:g}', or with larger cells"
        )


def warn_of_buried(
    model: mujoco.MjModel, geoms: Sequence[int], surface: Surface, memory: Memory
) -> None:
    """Warn of a geom that starts fully under the sand, at qpos0.

    Args:
        model: the model.
        geoms: ids of the geoms that meet the sand.
        surface: the surface without memory.
        memory: its memory.

    Warns:
        GranularWarning: names the geom and its depth.
    """
    if isinstance(surface, HeightField):
        return  # its heights may be set later
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
