"""Flow of sand in each world where it is steeper than its angle of repose."""

# Kernels are written in Warp's language, which Python type checkers do not understand.
# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportCallIssue=false
# pyright: reportOperatorIssue=false, reportGeneralTypeIssues=false, reportIndexIssue=false
# pyright: reportAttributeAccessIssue=false, reportAssignmentType=false

# No `from __future__ import annotations`: Warp reads the types of local structs in place.
import functools
from typing import Any

import warp as wp

from mjgranular.relief.flow import REST, excess_of, gains_of, slope_to
from mjgranular.relief.press import has_edges, is_sand
from mjgranular.warp.grid import in_world, node_in, tile_of, wrapped
from mjgranular.warp.translate import translated
from mjgranular.warp.update import FLOWS, LANES, claim

_is_sand, _has_edges = translated(is_sand), translated(has_edges)
_slope_to, _excess_of, _gains_of = (translated(each) for each in (slope_to, excess_of, gains_of))


@functools.cache
def flow_kernel(relief_struct: Any, level: Any) -> Any:
    """Make the kernel for flow of sand on a kind of surface with a `level` (`relief.probe`)."""
    level_at = translated(level)

    @wp.kernel(module="unique", enable_backward=False)
    def flow(
        surface: relief_struct,
        task: wp.array(dtype=int),
        rate: wp.array(dtype=float),
        foot: wp.array3d(dtype=int),
        first_row: int,
        first_column: int,
        volumes: wp.array2d(dtype=float),
    ):
        """Level the steepest triangles of every other square along both axes.

        Sand does not flow over stored heights that belong to another tile.
        """
        world, lane = wp.tid()
        if task[world] != FLOWS:
            return
        relief = in_world(surface, world)
        grid, cell, size = relief.state, relief.cell, relief.size
        has_edge = _has_edges(relief)
        up = wp.vec3(relief.along[2], relief.across[2], relief.normal[2])
        flat_a, flat_b = -up[0] / up[2], -up[1] / up[2]
        half = size // 2
        for n in range(lane, half * half, LANES):
            row, column = 2 * (n // half) + first_row, 2 * (n % half) + first_column
            # The first node follows from which of the two moved.
            i, j = int(0), int(0)
            known = int(0)
            for k in range(4):
                di, dj = k // 2, k % 2
                x, y = wrapped(row + di, size), wrapped(column + dj, size)
                tile = grid.tile[world, x, y]
                if known == 0 and tile != 0:
                    i, j = node_in(tile, x, y, size)
                    i = i - di
                    j = j - dj
                    known = int(1)
            if known == 0:
                continue
            heights = wp.vec4()
            for k in range(4):
                di, dj = k // 2, k % 2
                x, y = wrapped(row + di, size), wrapped(column + dj, size)
                tile = grid.tile[world, x, y]
                u, v = float(i + di) * cell, float(j + dj) * cell
                height = (grid.height[world, x, y] + level_at(relief, u, v)) / cell
                if (
                    foot[world, x, y] >= 0
                    or (tile != 0 and tile != tile_of(i + di, j + dj, size))
                    or (has_edge and not _is_sand(relief, u, v))
                ):
                    height = wp.nan
                heights[k] = height
            steepest, corner = float(REST), int(-1)
            for k in range(4):
                di, dj = k // 2, k % 2
                s, t = 1.0 - 2.0 * float(di), 1.0 - 2.0 * float(dj)
                a = _slope_to(heights[k], heights[2 * (1 - di) + dj], s, flat_a)
                b = _slope_to(heights[k], heights[2 * di + 1 - dj], t, flat_b)
                excess = _excess_of(a, b, up, relief.repose)
                if excess > steepest and not wp.isnan(heights[k]):
                    steepest = excess
                    corner = k
            if corner < 0:
                continue
            di, dj = corner // 2, corner % 2
            ahead, beside = 2 * (1 - di) + dj, 2 * di + 1 - dj
            s, t = 1.0 - 2.0 * float(di), 1.0 - 2.0 * float(dj)
            a = _slope_to(heights[corner], heights[ahead], s, flat_a)
            b = _slope_to(heights[corner], heights[beside], t, flat_b)
            s = wp.where(wp.isnan(heights[ahead]), 0.0, s)
            t = wp.where(wp.isnan(heights[beside]), 0.0, t)
            g, h = _gains_of(a, b, up, relief.repose, s, t, rate[world])
            gained = wp.vec4()
            gained[corner] = -g - h
            gained[ahead] = g
            gained[beside] = h
            for k in range(4):
                if gained[k] != 0.0:
                    di, dj = k // 2, k % 2
                    x, y = wrapped(row + di, size), wrapped(column + dj, size)
                    claim(relief, tile_of(i + di, j + dj, size), x, y, volumes)
                    grid.height[world, x, y] += cell * gained[k]

    return flow
