"""What each world's sand remembers: its arrays on the device, and its update after each step."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import warp as wp

from mjgranular.errors import InputError
from mjgranular.relief.footprint import Footprint
from mjgranular.relief.heights import Heights, square_about
from mjgranular.relief.probe import level_kernel
from mjgranular.relief.relief import Relief
from mjgranular.warp.grid import Grid, tiles_of
from mjgranular.warp.records import struct_of_surface, surface_on_device
from mjgranular.warp.update import (
    DIRECTIONS,
    FORGOTTEN,
    HEAPED,
    LANES,
    MOST_FEET,
    PRESSED,
    UNWANTED,
    Skin,
    update_kernels,
)

_BYTES = 4 + 4 + 8 + 4  # of a node: height, tile, what skin wants, and the foot there


class WarpMemory:
    """Heights of the sand in each world.

    Args:
        relief: the surface.
        footprint: the skin of its bodies.
        record: of the surface.
        model: that they are in.
        count: of worlds.
        device: of Warp's.

    Attributes:
        surface: struct of the surface, with the heights, as kernels read it.

    Raises:
        InputError: more than the device has memory for, or too many geoms.
    """

    def __init__(
        self,
        relief: Relief,
        footprint: Footprint,
        record: np.ndarray,
        model: mujoco.MjModel,
        count: int,
        device: Any,
    ) -> None:
        memory, size = relief.memory, relief.memory.size
        blocks = memory.blocks(relief.surroundings)
        _check_room(memory, count, device)
        if len(footprint.feet) > MOST_FEET:
            raise InputError(
                f"in MuJoCo Warp at most {MOST_FEET} geoms press sand down, not "
                f"{len(footprint.feet)}: choose some by geoms="
            )
        self._relief, self._device, self._size = relief, device, (count, size, blocks)

        def zeros(shape: tuple[int, ...], kind: Any = float) -> wp.array:
            return wp.zeros(shape, dtype=kind, device=device)

        nodes, feet = (count, size, size), (count, len(footprint.feet))
        grid = Grid()
        grid.height, grid.tile = zeros(nodes), zeros(nodes, int)
        grid.sums, grid.highest = zeros((count, blocks, blocks)), zeros((count,))
        self._grid = grid
        self._wanted = wp.full(nodes, UNWANTED, dtype=wp.int64, device=device)
        self._foot = zeros(nodes, int)
        self._places = zeros(feet, wp.vec3)
        self._waiting, self._count = zeros(feet), zeros(feet, int)
        self._volumes = zeros((count, 3))
        self._last, self._since = zeros((count,)), zeros((count, 2))
        self._task, self._rate = zeros((count,), int), zeros((count,))
        self._skin = wp.array(_skin_of(footprint), dtype=Skin, device=device)

        self.surface = surface_on_device(relief, record, model, device, grid)
        level = level_kernel(type(relief.base).probe, relief.is_flat)
        self._kernels = update_kernels(struct_of_surface(relief, record), level)

    def update(self, m: Any, d: Any, height: wp.array, up: wp.vec3) -> None:
        """Presses sand down under the bodies of each world, heaps it up beside them, has it flow.

        Args:
            m: MuJoCo Warp's model.
            d: its data.
            height: how much the surface is raised in each world [m].
            up: the direction of that.
        """
        k, surface, foot, task = self._kernels, self.surface, self._foot, self._task
        (worlds, _, blocks), feet = self._size, self._count.shape[1]
        books, counted = [self._waiting, self._volumes], [self._waiting, self._count]
        self._launch(
            k.begin,
            worlds,
            [d.time, m.opt.gravity, self._relief.memory.cell],
            [self._last, self._since, task, self._rate, *counted, self._volumes],
            [self._grid.highest],
        )
        over_nodes = (worlds, LANES)
        there = [self._skin, task, height, up, d.xpos, d.xmat]
        self._launch(k.press, over_nodes, [surface, *there], [self._wanted, self._places])
        self._launch(k.settle, over_nodes, [surface, task, self._places, self._wanted, foot], books)
        self._launch(k.edge, over_nodes, [surface, task, foot])
        self._launch(k.surround, over_nodes, [surface, task, self._places, foot], counted)
        at_print = [surface, task, self._places, foot, *counted]
        self._launch(k.heap, over_nodes, at_print, [self._volumes])
        self._launch(k.keep, (worlds, feet), [surface, task, *counted], [self._volumes])
        for di, dj in DIRECTIONS:
            for parity in (0, 1):
                flowing = [surface, task, self._rate, foot, di, dj, parity]
                self._launch(k.flow, over_nodes, flowing, [self._volumes])
        self._launch(k.sum_up, (worlds, blocks * blocks), [surface, task])

    def volumes(self) -> dict[str, np.ndarray]:
        """Volumes of each world since it began [m^3], shape (nworld,) each.

        Returns:
            `pressed` down, `heaped` up, `forgotten` where the grid is wrapped around, and `waiting`
            for room beside a print.
        """
        found = self._volumes.numpy()
        return {
            "pressed": found[:, PRESSED],
            "heaped": found[:, HEAPED],
            "forgotten": found[:, FORGOTTEN],
            "waiting": self._waiting.numpy().sum(1),
        }

    def heights(self, world: int, middle: tuple[float, float]) -> Heights:
        """The heights of a world about a place; see `WarpSand.relief`."""
        memory = self._relief.memory
        size = memory.size
        i, j = square_about(memory, middle)
        places = np.ix_(i % size, j % size)
        own = self._grid.tile[world].numpy()[places] == tiles_of(i[:, None], j, size)
        height = self._grid.height[world].numpy()[places].astype(float)
        return Heights(memory.cell * i, memory.cell * j, np.where(own, height, 0.0))

    def _launch(self, kernel: Any, dim: Any, *arguments: list[Any]) -> None:
        inputs = [each for part in arguments for each in part]
        wp.launch(kernel, dim=dim, inputs=inputs, device=self._device)


def _check_room(memory: Any, count: int, device: Any) -> None:
    """Checks that a device has room for what so many worlds remember.

    Raises:
        InputError: says how much it has, and which cells would fit.
    """
    if not device.is_cuda:
        return
    needed, free = _BYTES * count * memory.size**2, device.free_memory
    if needed > free:
        fits = memory.cell * (needed / free) ** 0.5
        raise InputError(
            f"a memory of {memory.size} by {memory.size} cells in {count} worlds takes "
            f"{needed / 2**30:.2g} GiB, and {device.alias} has {free / 2**30:.2g} GiB left: take "
            f"cells of {1.05 * fits:.2g} m, a smaller extent, or fewer worlds"
        )


def _skin_of(footprint: Footprint) -> np.ndarray:
    """The points of a footprint, each with the number of its foot."""
    points = footprint.points.transpose(0, 2, 1)  # tile by tile, point by point
    tiles, lanes, _ = points.shape
    skin = np.zeros(tiles * lanes, Skin.numpy_dtype())
    feet = np.searchsorted(footprint.feet["end"], np.arange(tiles), side="right").repeat(lanes)
    skin["foot"], skin["body"] = feet, footprint.feet["body"][feet]
    skin["point"], skin["normal"] = points.reshape(-1, 6)[:, :3], points.reshape(-1, 6)[:, 3:]
    return skin
