"""The kernel that fits the vertices of a skin to the sand, and adds rectangles where it is plane.

It draws a window of the skin's grid around the robot, block by block. Blocks in which sand has
moved have their vertices in place. The others have theirs in one point under the surface, where
they cost nothing, and are drawn as rectangles. Beside a drawn block the next vertices are slightly
under the rectangles, so that normals, which MuJoCo computes from triangles, have no edge there.
"""

import math
from functools import cache, partial
from typing import Any

import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.memory import floats, longs, records
from mjgranular.kernel.vector import read_vector
from mjgranular.relief.grid import HEIGHT, base_of, own_mark, place_of, start_of
from mjgranular.relief.memory import Memory
from mjgranular.relief.probe import level_kernel, state_length
from mjgranular.relief.relief import Relief, relief_dtype
from mjgranular.render.skin import BLOCK, lines_of, stride_of, vertex_count
from mjgranular.surface import Surface

CANVAS_DTYPE = np.dtype(
    [
        ("surface", np.int64),  # address: record of the relief
        ("vertices", np.int64),  # address: of the skin, float32
        ("vertex_count", np.int64),
        ("lines", np.int64),  # vertices along a side
        ("stride", np.int64),  # distance between vertices in nodes of the memory
        ("blocks", np.int64),  # address: a number for each block
        ("rectangles", np.int64),  # address: their centers and half their edges [m]
        ("room", np.int64),  # capacity for rectangles
        ("count", np.int64),  # present number of rectangles
        ("unit", np.float64),  # of the plane beyond the window [m]
        ("bounded", np.int64),  # whether the sand ends
        ("low", np.float64, (2,)),  # its ends along the axes of the plane [m]
        ("high", np.float64, (2,)),
        ("bottom", np.float64),  # lower edge of its walls, over the plane [m]; 0 for none
        ("held", np.int64),  # whether the center of the window is fixed
        ("middle", np.float64, (2,)),  # center of the window, along the axes of the plane [m]
        ("sunk", np.float64),  # height of the drawing beyond the window over its true place [m]
    ]
)

FRAME_DTYPE = np.dtype(
    [(name, np.float64, (3,)) for name in ("origin", "along", "across", "normal")]
)
"""Fields of a relief's record: the plane under the heights."""

SIGNATURE = "int64(int64, float64)"  # signature of the program that fits a skin to the sand

Region = tuple[np.ndarray, np.ndarray, float]
"""A rectangle of sand in the plane under the heights: its lowest and highest corner, and the lower
edge of its walls over the plane, 0 for none [m]."""

_HAIR = 0.02  # distance of hidden vertices under rectangles [cells]
_ENDS = 5.0  # nodes at the edge of a window over which tracks fade out
_SLOPE = 0.25  # the same where the window descends to a lower field, in sides of the window
_BEYOND = (3.0, 10.0, 64.0)  # ends of rectangles beyond the window, in units: small ones are near
_FAR = 1 << 19  # nodes: beyond all node numbers

canvases = records(CANVAS_DTYPE)
_vertices = records(np.dtype(np.float32))


def room_for(lines: int) -> int:
    """Return the maximum number of rectangles."""
    side = lines // BLOCK
    return side * (side // 2 + 1) + 49


@partial(compiled, inline=True)
def within(x, low, high):
    """Return a number clipped to an interval."""
    return min(max(x, low), high)


@compiled
def put(vertices, number, relief, u, v, z):
    """Move a vertex to a position along the axes of the plane [m]."""
    origin, along = read_vector(relief.origin, 0), read_vector(relief.along, 0)
    across, normal = read_vector(relief.across, 0), read_vector(relief.normal, 0)
    point = origin + u * along + v * across + z * normal
    vertices[3 * number] = point.x
    vertices[3 * number + 1] = point.y
    vertices[3 * number + 2] = point.z


@compiled
def add_rectangle(canvas, u0, u1, v0, v1):
    """Add a rectangle, clipped to the sand."""
    if canvas.bounded:
        u0, u1 = max(u0, canvas.low[0]), min(u1, canvas.high[0])
        v0, v1 = max(v0, canvas.low[1]), min(v1, canvas.high[1])
    if u0 < u1 and v0 < v1 and canvas.count < canvas.room:
        row = floats(canvas.rectangles, 4 * canvas.room)
        k = 4 * canvas.count
        row[k], row[k + 1] = 0.5 * (u0 + u1), 0.5 * (v0 + v1)
        row[k + 2], row[k + 3] = 0.5 * (u1 - u0), 0.5 * (v1 - v0)
        canvas.count += 1


@compiled
def line_around(canvas, number, begin, end):
    """Return end `number`, 0 to 7, of the rectangles around a window from `begin` to `end` [m]."""
    if number < 3:
        return begin - _BEYOND[2 - number] * canvas.unit
    if number == 3:
        return begin
    if number == 4:
        return end
    return end + _BEYOND[number - 5] * canvas.unit


@compiled
def add_rectangles(canvas, blocks, side, u, v, width):
    """Add rectangles for the part of a plane that the skin does not show.

    `blocks` says which blocks, `side` x `side` of that width [m] from (u, v), the skin draws.
    """
    canvas.count = 0
    for a in range(side):
        first = 0
        for b in range(side + 1):
            if b == side or blocks[a * side + b] != 0:
                if b > first:
                    add_rectangle(
                        canvas, u + a * width, u + (a + 1) * width, v + first * width, v + b * width
                    )
                first = b + 1
    for a in range(7):
        for b in range(7):
            if a != 3 or b != 3:
                u0 = line_around(canvas, a, u, u + side * width)
                u1 = line_around(canvas, a + 1, u, u + side * width)
                v0 = line_around(canvas, b, v, v + side * width)
                v1 = line_around(canvas, b + 1, v, v + side * width)
                add_rectangle(canvas, u0, u1, v0, v1)


@compiled
def first_of(canvas, axis, cell):
    """Return the first node of the window along an axis, that of a block."""
    side, width = canvas.lines // BLOCK, BLOCK * cell
    middle = canvas.middle[axis] / width
    if not abs(middle) < _FAR // (BLOCK * canvas.stride):  # also if it is NaN
        middle = 0.0
    return BLOCK * (math.floor(middle + 0.5) - side // 2)


@cache
def shape_kernel(probe: Any, is_flat: bool, dtype: np.dtype) -> Any:
    """Make the program `shape(canvas, 0.0)`, which fills in a record of `CANVAS_DTYPE`."""
    level, reliefs = level_kernel(probe, is_flat), records(dtype)

    @partial(compiled, inline=True)
    def width_of(canvas, relief):
        """Return the distance between vertices [m]."""
        return canvas.stride * relief.cell

    @compiled
    def height(canvas, relief, state, i, j):
        """Return the height of the sand at a vertex over the surface [m]; NaN if untouched."""
        i, j = canvas.stride * i, canvas.stride * j
        k = place_of(relief.size, i, j)
        if own_mark(state, relief.size, k, base_of(i, j)) < 0.0:
            return 0.0
        found = state[start_of(relief.size, HEIGHT) + k]
        return found if math.isfinite(found) else 0.0

    @compiled
    def place(canvas, relief, i, j):
        """Return where a node is drawn, (u, v) [m], and the surface's level there [m]."""
        u, v = i * width_of(canvas, relief), j * width_of(canvas, relief)
        if canvas.bounded:
            u = within(u, canvas.low[0], canvas.high[0])
            v = within(v, canvas.low[1], canvas.high[1])
        return u, v, level(relief, u, v)

    @compiled
    def choose(canvas, relief, state, blocks, first_i, first_j):
        """Select the blocks drawn with the skin; return the lowest height over the plane [m]."""
        side, cell = canvas.lines // BLOCK, width_of(canvas, relief)
        width = BLOCK * cell
        lowest = deepest = 0.0
        for a in range(side):
            for b in range(side):
                blocks[a * side + b] = 0
                u, v = first_i * cell + a * width, first_j * cell + b * width
                if a == 0 or b == 0 or a == side - 1 or b == side - 1:
                    if not is_flat:  # what joins the ends of the window must be under these
                        i, j = first_i + a * BLOCK, first_j + b * BLOCK
                        lowest = min(lowest, place(canvas, relief, i, j)[2])
                    continue
                if canvas.bounded and not (
                    u < canvas.high[0] and v < canvas.high[1]
                    and u + width > canvas.low[0] and v + width > canvas.low[1]
                ):  # fmt: skip
                    continue
                chosen = 0 if is_flat else 1
                for i in range(first_i + a * BLOCK - 1, first_i + (a + 1) * BLOCK + 2):
                    for j in range(first_j + b * BLOCK - 1, first_j + (b + 1) * BLOCK + 2):
                        h = height(canvas, relief, state, i, j)
                        if h != 0.0:
                            chosen = 1
                            deepest = min(deepest, h)
                        if not is_flat:
                            h += place(canvas, relief, i, j)[2]
                        lowest = min(lowest, h)
                blocks[a * side + b] = chosen
        canvas.sunk = 0.0
        if not is_flat and not canvas.held:
            canvas.sunk = deepest - 10.0 * _HAIR * cell
        return lowest

    @compiled
    def inside(canvas, cell, axis, i):
        """Return the node in the sand that is nearest to another along an axis."""
        if not canvas.bounded:
            return i
        low, high = math.ceil(canvas.low[axis] / cell), math.floor(canvas.high[axis] / cell)
        return max(min(i, high), low)

    @compiled
    def sand_at(canvas, relief, state, i, j):
        """Return the height over the surface [m] at the node that is drawn for (i, j)."""
        cell = width_of(canvas, relief)
        return height(
            canvas, relief, state, inside(canvas, cell, 0, i), inside(canvas, cell, 1, j)
        )  # fmt: skip

    @compiled
    def fill(canvas, relief, state, blocks, first_i, first_j, lowest):
        """Move all vertices of the surface to their positions."""
        n, cell = canvas.lines, width_of(canvas, relief)
        side, hair = n // BLOCK, _HAIR * cell
        vertices = _vertices(canvas.vertices, 3 * canvas.vertex_count)
        for a in range(n):
            i, row, p = first_i + a, a // BLOCK, a % BLOCK
            for b in range(n):
                j, column, q = first_j + b, b // BLOCK, b % BLOCK
                kept = seen = False
                for da in range(-1, 2):
                    if (da == -1 and p > 1) or (da == 1 and p < BLOCK - 1):
                        continue
                    for db in range(-1, 2):
                        if (db == -1 and q > 1) or (db == 1 and q < BLOCK - 1):
                            continue
                        x, y = row + da, column + db
                        if x < 0 or y < 0 or x >= side or y >= side or blocks[x * side + y] == 0:
                            continue
                        kept = True
                        if (da == 0 or (da == -1 and p == 0)) and (
                            db == 0 or (db == -1 and q == 0)
                        ):
                            seen = True
                number = (i % n) * n + j % n
                if kept:
                    # At its edge the window descends, or rises, to what is drawn beyond.
                    near = min(min(a, n - a), min(b, n - b)) - BLOCK
                    u, v, z = place(canvas, relief, i, j)
                    z += sand_at(canvas, relief, state, i, j) * within(near / _ENDS, 0.0, 1.0)
                    high = within(near / (_SLOPE * n), 0.0, 1.0)
                    z += canvas.sunk * (1.0 - high * high * (3.0 - 2.0 * high))
                    z -= 0.0 if seen else hair
                else:
                    middle = BLOCK // 2 - 1
                    u, v, z = place(
                        canvas, relief, first_i + row * BLOCK + middle,
                        first_j + column * BLOCK + middle,
                    )  # fmt: skip
                    z -= 2.0 * hair
                    if canvas.bounded:  # behind the walls
                        u = within(u, canvas.low[0] + cell, canvas.high[0] - cell)
                        v = within(v, canvas.low[1] + cell, canvas.high[1] - cell)
                    # Triangles that join the ends of the window are under everything visible.
                    if row == 0 or column == 0 or row == side - 1 or column == side - 1:
                        z = lowest + canvas.sunk - cell
                put(vertices, number, relief, u, v, z)

    @compiled
    def wall(canvas, relief, state, first_i, first_j, lowest):
        """Move the vertices of the walls to their positions; an infinite surface has none."""
        n, cell = canvas.lines, width_of(canvas, relief)
        vertices = _vertices(canvas.vertices, 3 * canvas.vertex_count)
        number = n * n
        for side in range(4):
            for k in range(n + 2):
                u, v, z, bottom = first_i * cell, first_j * cell, lowest - cell, lowest - cell
                if canvas.bounded and canvas.bottom < 0.0:
                    axis = 0 if side < 2 else 1
                    node = (first_i if axis == 0 else first_j) + k - 1
                    low, high = canvas.low[axis], canvas.high[axis]
                    along = within(node * cell, low, high)
                    if k == 0:
                        along = low
                    elif k == n + 1:
                        along = high
                    edge = canvas.low[1 - axis] if side % 2 == 0 else canvas.high[1 - axis]
                    other = math.floor(edge / cell + 0.5)
                    u, v = (along, edge) if axis == 0 else (edge, along)
                    i, j = (node, other) if axis == 0 else (other, node)
                    bottom = canvas.bottom
                    z = level(relief, u, v) + sand_at(canvas, relief, state, i, j)
                put(vertices, number, relief, u, v, z)
                put(vertices, number + 1, relief, u, v, min(bottom, z))
                number += 2

    @compiled
    def shape(address, lead):
        canvas = canvases(address, 1)[0]
        relief = reliefs(canvas.surface, 1)[0]
        state = floats(relief.state, state_length(relief.size))
        side, cell = canvas.lines // BLOCK, width_of(canvas, relief)
        blocks = longs(canvas.blocks, side * side)
        first_i, first_j = first_of(canvas, 0, cell), first_of(canvas, 1, cell)
        lowest = choose(canvas, relief, state, blocks, first_i, first_j)
        fill(canvas, relief, state, blocks, first_i, first_j, lowest)
        wall(canvas, relief, state, first_i, first_j, lowest)
        canvas.count = 0
        if is_flat:
            add_rectangles(canvas, blocks, side, first_i * cell, first_j * cell, BLOCK * cell)
        return 1

    return shape


def shape_of(relief: Relief, base: np.dtype) -> Any:
    """Return the program of a relief over a surface with that record."""
    surface: type[Surface] = type(relief.base)
    return shape_kernel(surface.probe, relief.is_flat, relief_dtype(base))


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
