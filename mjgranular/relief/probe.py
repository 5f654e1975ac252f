"""A surface with a relief: what a body meets of it.

Resistance goes with the depth below the sand *around* the body, not below what it has pressed down
itself. And there is none where there is no sand: a face that has moved away from the sand that it
pressed moves freely until it meets sand again. So

    depth = (around - z) min((height - z) / min(slack, around - z), 1)

with z the place's own height, `height` that of the sand there, and `around` that of the sand around
the body. On untouched sand `height` is `around`, and the depth is that below the surface, exactly.
`slack` is what is left of the depth of a print: sand is pressed down to within it, so that who
stands still in his print is held by all of it, and force falls to nothing as he rises by as much.

What resists a steep face is the sand ahead of it, a cell and a half away; what resists a flat one
is under it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import mujoco
import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.memory import floats
from mjgranular.kernel.vector import dot, norm, read_vector
from mjgranular.relief.grid import HIGHEST, height_at, mean_at, state_size
from mjgranular.relief.memory import Memory
from mjgranular.surface import Bed, HeightField, Plane, Surface

AHEAD = 1.5
"""How far ahead of a steep face its sand is looked at [cells]: beyond all nodes that the body
itself has pressed down. Chosen."""

STEEP = 0.7
"""Sine of the tilt above which a face looks ahead, and presses nothing down: 45 degrees. Chosen."""

SLACK = 0.1
"""Depth of what stands in its print below the sand that it has pressed down [cells]. Chosen."""

SETTLED = 0.96
"""Share of the tangent of repose at which sand flows between neighbours: eight directions allow a
slope that is up to 8 % steeper between them. Chosen so that both lie about the angle alike."""


@cache
def relief_dtype(base: np.dtype) -> np.dtype:
    """The record of a relief over a surface with that record."""
    vectors = [(name, np.float64, (3,)) for name in ("origin", "along", "across", "normal")]
    numbers = ("cell", "slack", "repose", "bulking", "half_along", "half_across")
    integers = ("size", "blocks", "state", "footprint", "bodies", "body_count")
    return np.dtype(
        [
            ("base", base),
            *vectors,
            *((name, np.float64) for name in numbers),
            *((name, np.int64) for name in integers),
        ]
    )


@cache
def level_kernel(probe: Any, is_plane: bool) -> Any:
    """Makes a kernel `level(relief, u, v)`: the surface's height over its own plane [m]."""

    @compiled
    def level(relief, u, v):
        origin, n = read_vector(relief.origin, 0), read_vector(relief.normal, 0)
        point = origin + u * read_vector(relief.along, 0) + v * read_vector(relief.across, 0)
        depth, normal = probe(relief.base, point)
        return depth / dot(normal, n)

    @partial(compiled, inline=True)
    def none(relief, u, v):
        return 0.0

    return none if is_plane else level


@cache
def look_kernel(probe: Any, is_flat: bool) -> Any:
    """Makes a kernel `look(relief, point, ahead)`: depth of a point, by the sand ahead; the normal.

    Args:
        probe: of the surface itself.
        is_flat: whether that is plane where it is.
    """
    level = level_kernel(probe, is_flat)

    @compiled
    def look(relief, point, ahead):
        depth, normal = probe(relief.base, point)
        place = point - read_vector(relief.origin, 0)
        z = dot(place, read_vector(relief.normal, 0))
        place = place + ahead
        u, v = dot(place, read_vector(relief.along, 0)), dot(place, read_vector(relief.across, 0))
        # Beside a bed, or under it, there is no sand.
        if not (abs(u) <= relief.half_along and abs(v) <= relief.half_across):
            return depth, normal
        if z < 0.0 and depth < 0.0 and is_flat:
            return depth, normal
        size, blocks, cell = relief.size, relief.blocks, relief.cell
        state = floats(relief.state, state_length(size, blocks))
        height = height_at(state, size, cell, u, v)
        around = max(mean_at(state, size, blocks, cell, u, v), -1e9)
        base = level(relief, u, v)
        above, deep = base + height - z, base + around - z
        if not above > 0.0:
            return above, normal
        if not deep > 0.0:
            return deep, normal
        share = min(above / min(relief.slack, deep), 1.0)
        return share * deep * dot(normal, read_vector(relief.normal, 0)), normal

    return look


state_length = compiled(state_size)
"""`state_size` for kernels."""


@cache
def toward_kernel(probe: Any, is_flat: bool) -> Any:
    """Makes a kernel `toward(relief, point, outward)`: `look` from a face with that normal."""
    look = look_kernel(probe, is_flat)

    @compiled
    def toward(relief, point, outward):
        n = read_vector(relief.normal, 0)
        level = outward - dot(outward, n) * n
        tilt = norm(level)
        ahead = 0.0 * level
        if tilt > STEEP:
            ahead = (AHEAD * relief.cell * (tilt - STEEP) / ((1.0 - STEEP) * tilt)) * level
        return look(relief, point, ahead)

    return toward


@cache
def around_kernel(probe: Any, is_flat: bool) -> Any:
    """Makes a kernel `around(relief, point)`: the deepest of `look` to four sides and under it.

    For elements without a face, such as the axis of a rod: sand on any side resists them.
    """
    look = look_kernel(probe, is_flat)

    @compiled
    def around(relief, point):
        depth, normal = look(relief, point, 0.0 * point)
        along = (AHEAD * relief.cell) * read_vector(relief.along, 0)
        across = (AHEAD * relief.cell) * read_vector(relief.across, 0)
        depth = max(depth, look(relief, point, along)[0])
        depth = max(depth, look(relief, point, -along)[0])
        depth = max(depth, look(relief, point, across)[0])
        return max(depth, look(relief, point, -across)[0]), normal

    return around


@cache
def ceiling_kernel(probe: Any) -> Any:
    """Makes a kernel `ceiling(relief, point)`: the plane above all that is heaped up."""

    @compiled
    def ceiling(relief, point):
        depth, normal = probe(relief.base, point)
        return depth + floats(relief.state, 1)[HIGHEST], normal

    return ceiling


@dataclass(frozen=True)
class Relief(Surface):
    """A surface that remembers.

    Attributes:
        base: the surface without memory.
        memory: how it remembers.
    """

    base: Surface
    memory: Memory

    def probe_kernel(self) -> Any:
        return around_kernel(type(self.base).probe, self.is_flat)

    def toward_kernel(self) -> Any:
        return toward_kernel(type(self.base).probe, self.is_flat)

    def ceiling_kernel(self) -> Any:
        return ceiling_kernel(type(self.base).probe) if type(self.base).is_plane else None

    @property
    def state_size(self) -> int:
        return state_size(self.memory.size, self.memory.blocks)

    @property
    def is_flat(self) -> bool:
        """Whether the surface itself is plane where it is."""
        return isinstance(self.base, (Plane, Bed))

    def record(self, model: mujoco.MjModel) -> np.ndarray:
        base, memory = self.base.record(model), self.memory
        relief = np.zeros(1, relief_dtype(base.dtype))
        relief["base"] = base
        frame = frame_of(self.base, base[0])
        for name, value in frame.items():
            relief[name] = value
        relief["cell"], relief["slack"] = memory.cell, SLACK * memory.cell
        relief["repose"], relief["bulking"] = SETTLED * np.tan(memory.repose), memory.bulking
        relief["size"], relief["blocks"] = memory.size, memory.blocks
        return relief

    def geoms(self, model: mujoco.MjModel) -> tuple[int, ...]:
        return self.base.geoms(model)

    def shape(self, model: mujoco.MjModel) -> tuple[np.ndarray, ...]:
        return self.base.shape(model)

    def lift(self, model: mujoco.MjModel) -> Mapping[str, np.ndarray]:
        raise NotImplementedError

    def tilt(self, model: mujoco.MjModel) -> float:
        return self.base.tilt(model)


def frame_of(surface: Surface, record: Any) -> dict[str, Any]:
    """The plane that heights are over: origin, axes, half its extents [m]."""
    if isinstance(surface, Plane):
        normal = record["normal"]
        along = np.array([1.0, 0.0, 0.0])
        along = along - normal[0] * normal
        along /= np.linalg.norm(along)
        return {
            "origin": record["offset"] * normal,
            "along": along,
            "across": np.cross(normal, along),
            "normal": normal,
            "half_along": np.inf,
            "half_across": np.inf,
        }
    if isinstance(surface, Bed):
        names = ("along", "across", "normal", "half_along", "half_across")
        return {"origin": record["top"], **{name: record[name] for name in names}}
    assert isinstance(surface, HeightField)
    axes = record["axes"].reshape(3, 3)
    return {
        "origin": record["position"],
        "along": axes[:, 0],
        "across": axes[:, 1],
        "normal": axes[:, 2],
        "half_along": record["half_x"],
        "half_across": record["half_y"],
    }
