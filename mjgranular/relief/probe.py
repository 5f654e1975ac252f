"""Kernels that compute depth under a surface with a relief.

Resistance depends on the depth below the sand *around* the body, not below the track that it has
pressed itself. And it is zero where there is no sand: a face that has moved away from the sand that
it pressed moves freely until it meets sand again. So

    depth = (around - z) min((height - z) / min(slack, around - z), 1)

with z the height of the point, `height` that of the sand there, and `around` the mean around the
body. On untouched sand both are 0, and the depth is exactly that below the surface. `slack` is the
remaining depth in a track: sand is pressed down to within it, so that a body standing still in its
track is supported by all of the resistance, which falls to zero as the body rises by that much.

A steep face is resisted by the sand a cell and a half ahead of it; a flat one by that under it.
"""

from functools import cache, partial
from typing import Any

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.memory import floats
from mjgranular.kernel.vector import dot, norm, read_vector
from mjgranular.relief.grid import HIGHEST, height_at, mean_at, state_size

AHEAD = 1.5
"""How far ahead of a steep face sand is evaluated [cells]; chosen: past what it pressed down."""

STEEP = 0.7
"""Sine of the tilt from which a face looks ahead and presses nothing down; chosen: 45 degrees."""

state_length = compiled(state_size)  # `state_size` for kernels


@partial(compiled, inline=True)
def highest_of(relief):
    """Return an upper bound of the sand's height [m]."""
    return floats(relief.state, 1)[HIGHEST]


@cache
def level_kernel(probe: Any, is_flat: bool) -> Any:
    """Make a kernel `level(relief, u, v)`: the surface's height over its own plane [m]."""

    @compiled
    def level(relief, u, v):
        origin, n = read_vector(relief.origin, 0), read_vector(relief.normal, 0)
        point = origin + u * read_vector(relief.along, 0) + v * read_vector(relief.across, 0)
        depth, normal = probe(relief.base, point)
        return depth / dot(normal, n)

    @partial(compiled, inline=True)
    def none(relief, u, v):
        return 0.0

    return none if is_flat else level


@cache
def look_kernel(probe: Any, is_flat: bool, height: Any) -> Any:
    """Make a kernel `look(relief, point, ahead)`: depth of a point [m], and the normal above it.

    The height of the relevant sand [m] is that of the kernel `height(relief, state, u, v, ahead)`.
    """
    level = level_kernel(probe, is_flat)

    @compiled
    def look(relief, point, ahead):
        depth, normal = probe(relief.base, point)
        n = read_vector(relief.normal, 0)
        place = point - read_vector(relief.origin, 0)
        z = dot(place, n)
        u, v = dot(place, read_vector(relief.along, 0)), dot(place, read_vector(relief.across, 0))
        # There is no sand beside or under a bed.
        if not (abs(u) <= relief.half_along and abs(v) <= relief.half_across):
            return depth, normal
        if is_flat and z < 0.0 and depth < 0.0:
            return depth, normal
        size, blocks, cell = relief.size, relief.blocks, relief.cell
        state = floats(relief.state, state_length(size))
        z -= level(relief, u, v)
        above = height(relief, state, u, v, ahead) - z
        if not above > 0.0:
            return above, normal
        deep = mean_at(state, size, blocks, cell, u, v) - z
        if not deep > 0.0:
            return deep, normal
        return min(above / min(relief.slack, deep), 1.0) * deep * dot(normal, n), normal

    return look


@cache
def toward_kernel(probe: Any, is_flat: bool) -> Any:
    """Make a kernel `toward(relief, point, outward)`: `look` from a face with that normal.

    The more a face is tilted, the farther ahead it looks: a cell is too coarse to distinguish sand
    under one side of it from that under the other.
    """

    @partial(compiled, inline=True)
    def height(relief, state, u, v, ahead):
        u += dot(ahead, read_vector(relief.along, 0))
        v += dot(ahead, read_vector(relief.across, 0))
        return height_at(state, relief.size, relief.cell, u, v)

    look = look_kernel(probe, is_flat, height)

    @compiled
    def toward(relief, point, outward):
        n = read_vector(relief.normal, 0)
        if not is_flat:
            _, n = probe(relief.base, point)
        level = outward - dot(outward, n) * n
        tilt = norm(level)
        far = AHEAD * relief.cell / max(tilt, STEEP)
        return look(relief, point, far * level)

    return toward


@cache
def around_kernel(probe: Any, is_flat: bool) -> Any:
    """Make a kernel `around(relief, point)`: `look` at the highest sand under and beside a point.

    For elements without a face, such as the axis of a rod: sand on any side resists them.
    """

    @partial(compiled, inline=True)
    def height(relief, state, u, v, ahead):
        size, cell = relief.size, relief.cell
        far = AHEAD * cell
        highest = height_at(state, size, cell, u, v)
        highest = max(highest, height_at(state, size, cell, u + far, v))
        highest = max(highest, height_at(state, size, cell, u - far, v))
        highest = max(highest, height_at(state, size, cell, u, v + far))
        return max(highest, height_at(state, size, cell, u, v - far))

    look = look_kernel(probe, is_flat, height)

    @compiled
    def around(relief, point):
        return look(relief, point, point)

    return around


@cache
def ceiling_kernel(probe: Any) -> Any:
    """Make a kernel `ceiling(relief, point)`: a plane above all heaps."""

    @compiled
    def ceiling(relief, point):
        depth, normal = probe(relief.base, point)
        return depth + highest_of(relief), normal

    return ceiling
