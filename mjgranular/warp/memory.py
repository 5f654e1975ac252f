"""Memory of each world's sand: its arrays on the device, and its update after each step."""

from typing import Any

import mujoco
import numpy as np
import warp as wp

from mjgranular.errors import InputError
from mjgranular.relief.footprint import Footprint
from mjgranular.relief.memory import Heights, square_about
from mjgranular.relief.probe import level_kernel
from mjgranular.relief.relief import Relief
from mjgranular.warp import translate, update
from mjgranular.warp.grid import Grid, tiles_of


class WarpMemory:
    """Heights of the sand in each of `count` worlds, with a `record` of their surface.

    `footprint` has surface points of the bodies; kernels read the struct `surface` with heights.
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
        if len(footprint.feet) > update.MOST_FEET:
            raise InputError(
                f"in MuJoCo Warp at most {update.MOST_FEET} geoms press sand down, not "
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
        self._work = work = update.Work()
        work.wanted = wp.full(nodes, update.UNWANTED, dtype=wp.int64, device=device)
        work.foot = wp.full(nodes, update.NOTHING, dtype=int, device=device)
        work.places = zeros(feet, wp.vec3)
        work.waiting, work.count, work.volumes = zeros(feet), zeros(feet, int), zeros((count, 3))
        work.last, work.since = zeros((count,)), zeros((count, 2))
        work.task, work.rate = zeros((count,), int), zeros((count,))
        self._skin = wp.array(_skin_of(footprint), dtype=update.Skin, device=device)

        self.surface = translate.surface_on_device(relief, record, model, device, grid)
        self._plain = translate.plain_relief(record, grid)
        # Over a plane, all surfaces share one kernel.
        self._leveled = self._plain if relief.is_flat else self.surface
        plain, of_surface = translate.PlainRelief, translate.struct_of_surface
        struct = plain if relief.is_flat else of_surface(relief, record)
        level = level_kernel(type(relief.base).probe, relief.is_flat)
        self._press = update.press_kernel(struct, level)
        self._flow = update.flow_kernel(struct, level)

    def restart(self, d: Any) -> None:
        """Clear the sand of worlds whose time decreased."""
        over_nodes = (self._size[0], update.LANES)
        self._launch(update.restart, over_nodes, d.time, self._plain, self._work)

    def update(self, gravity: wp.array, d: Any, height: wp.array, up: wp.vec3) -> None:
        """Press sand down under the bodies of each world, deposit rims, and let it flow.

        In each world the surface is raised by `height` [m] along `up`.
        """
        relief, work = self._plain, self._work
        (worlds, _, blocks), feet = self._size, work.count.shape[1]
        over_nodes = (worlds, update.LANES)
        self._launch(update.begin, worlds, d.time, gravity, relief, work)
        pressing = (self._leveled, self._skin, work, height, up, d.xpos, d.xmat)
        self._launch(self._press, over_nodes, *pressing)
        for kernel in (update.settle, update.edge, update.surround, update.heap):
            self._launch(kernel, over_nodes, relief, work)
        self._launch(update.keep, (worlds, feet), relief, work)
        # Squares of one pass share no node.
        for first in np.ndindex(2, 2):
            self._launch(self._flow, over_nodes, gravity, self._leveled, work, *first)
        self._launch(update.sum_up, (worlds, blocks * blocks), relief, work)

    def volumes(self) -> dict[str, np.ndarray]:
        """Return the volumes of each world; see `WarpSand.volumes`."""
        pressed, heaped, forgotten = self._work.volumes.numpy().T
        waiting = self._work.waiting.numpy().sum(1)
        return {"pressed": pressed, "heaped": heaped, "forgotten": forgotten, "waiting": waiting}

    def heights(self, world: int, middle: tuple[float, float]) -> Heights:
        """Return the heights of a world around a point; see `WarpSand.relief`."""
        memory = self._relief.memory
        size = memory.size
        i, j = square_about(memory, middle)
        places = np.ix_(i % size, j % size)
        own = self._grid.tile[world].numpy()[places] == tiles_of(i[:, None], j, size)
        height = self._grid.height[world].numpy()[places].astype(float)
        return Heights(memory.cell * i, memory.cell * j, np.where(own, height, 0.0))

    def _launch(self, kernel: Any, dim: Any, *inputs: Any) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, device=self._device)


def _skin_of(footprint: Footprint) -> np.ndarray:
    """Return the points of a footprint, each with the index of its contact geom."""
    points = footprint.points.transpose(0, 2, 1)  # tile by tile, point by point
    tiles, lanes, _ = points.shape
    skin: Any = np.zeros(tiles * lanes, update.Skin.numpy_dtype())
    feet = np.searchsorted(footprint.feet["end"], np.arange(tiles), side="right").repeat(lanes)
    skin["foot"], skin["body"] = feet, footprint.feet["body"][feet]
    skin["point"], skin["normal"] = points.reshape(-1, 6)[:, :3], points.reshape(-1, 6)[:, 3:]
    return skin
