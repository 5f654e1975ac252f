"""Sand flows down in each world where it is steeper than it can rest."""

# The code of kernels is Warp's language, of which type checkers of Python know little.
# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportCallIssue=false
# pyright: reportOperatorIssue=false, reportGeneralTypeIssues=false, reportIndexIssue=false
# pyright: reportAttributeAccessIssue=false, reportAssignmentType=false

# Without `annotations` of the future: Warp reads types of local structs where they stand.
import functools
from typing import Any

import warp as wp

from mjgranular.relief.flow import REST, exchanged
from mjgranular.relief.press import has_edges, is_sand
from mjgranular.warp.grid import in_world, node_in, tile_of, wrapped
from mjgranular.warp.translate import translated
from mjgranular.warp.update import FLOWS, LANES, claim

DIRECTIONS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""To a node's neighbours; the other four are their opposites."""

_is_sand, _has_edges = translated(is_sand), translated(has_edges)
_exchanged = translated(exchanged)


@functools.cache
def flow_kernel(relief_struct: Any, level: Any) -> Any:
    """Makes the kernel by which sand flows, for surfaces of a kind.

    Args:
        relief_struct: struct of the surface.
        level: kernel, see `relief.probe.level_kernel`.
    """
    level_at = translated(level)

    @wp.kernel(module="unique", enable_backward=False)
    def flow(
        surface: relief_struct,
        task: wp.array(dtype=int),
        rate: wp.array(dtype=float),
        foot: wp.array3d(dtype=int),
        di: int,
        dj: int,
        parity: int,
        volumes: wp.array2d(dtype=float),
    ):
        """Has sand flow between nodes and their neighbours in a direction, every other pair.

        It does not flow over what is remembered of a place that lies a tile away.
        """
        world, lane = wp.tid()
        if task[world] != FLOWS:
            return
        relief = in_world(surface, world)
        grid, cell, size = relief.state, relief.cell, relief.size
        has_edge = _has_edges(relief)
        up = wp.vec3(relief.along[2], relief.across[2], relief.normal[2])
        for n in range(lane, size * size // 2, LANES):
            # Of rows, or along a row of columns, those of one parity begin a pair.
            row = wp.where(di == 1, 2 * (n // size) + parity, n // (size // 2))
            column = wp.where(di == 1, n % size, 2 * (n % (size // 2)) + parity)
            other_row, other_column = wrapped(row + di, size), wrapped(column + dj, size)
            tile = grid.tile[world, row, column]
            other_tile = grid.tile[world, other_row, other_column]
            if tile == 0 and other_tile == 0:
                continue
            if foot[world, row, column] >= 0 or foot[world, other_row, other_column] >= 0:
                continue
            # One of the two may not have been moved yet; not both belong to what lies farther off.
            if tile != 0:
                i, j = node_in(tile, row, column, size)
                beside = tile_of(i + di, j + dj, size)
                if other_tile != beside and other_tile != 0:
                    continue
                other_tile = beside
            else:
                k, m = node_in(other_tile, other_row, other_column, size)
                tile = tile_of(k - di, m - dj, size)
            i, j = node_in(tile, row, column, size)
            x, y = float(i) * cell, float(j) * cell
            far_x, far_y = float(i + di) * cell, float(j + dj) * cell
            higher = grid.height[world, other_row, other_column] - grid.height[world, row, column]
            higher += level_at(relief, far_x, far_y) - level_at(relief, x, y)
            rise = (up[0] * float(di) + up[1] * float(dj)) * cell + up[2] * higher
            run = float(di * di + dj * dj) * cell * cell + higher * higher - rise * rise
            amount = _exchanged(rise, run, relief.repose, REST * cell, rate[world])
            if amount == 0.0:
                continue
            if has_edge and not (_is_sand(relief, x, y) and _is_sand(relief, far_x, far_y)):
                continue
            claim(relief, tile, row, column, volumes)
            claim(relief, other_tile, other_row, other_column, volumes)
            grid.height[world, row, column] += amount
            grid.height[world, other_row, other_column] -= amount

    return flow
