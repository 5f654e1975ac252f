"""Find the elements in the sand and fill tiles with them: both schemes' loop over elements."""

import math
from functools import cache, partial
from typing import Any

import numpy as np

from mjgranular.kernel import memory
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.elementary import bits_of, number_of
from mjgranular.kernel.fields import column, rows, size_of
from mjgranular.kernel.lanes import all_of, choose, count_of
from mjgranular.kernel.memory import floats, records, scratch
from mjgranular.kernel.motion import velocity_at
from mjgranular.kernel.records import CONTACT_DTYPE, bodies_of, contacts_of
from mjgranular.kernel.vector import Vector, dot, write_vector
from mjgranular.law.kernel import LawKernel, level_kernel
from mjgranular.scheme import layout
from mjgranular.scheme.added import momentum_kernel, turn_kernel
from mjgranular.scheme.workspace import workspace_at
from mjgranular.scheme.wrenches import gravity_of, place_of, pose_at


def sampling_kernel(kernel: LawKernel, scene_dtype: np.dtype, finish: Any, *, compact: bool) -> Any:
    """Make a kernel `sample_all(table, workspace, tiles, step, lead)`.

    It visits all elements, stores their depths in their contacts, fills tiles with those in the
    sand, body by body, and returns the number of tiles. Its arguments are the simulation's table,
    whatever workspace `finish` expects, the address of the first tile, the distance between tiles
    in bytes (0 to reuse one tile), and the scheme's lead [s].

    The kernel `finish(table, workspace, body, place, g, tile, number, live, is_first, lead)` is
    called with each tile: its index, the number of elements in it, and whether it is the first of
    its body. Forces that it leaves in the tile are written to the contacts. `compact` merges the
    immersed elements of several packed tiles, which pays if forces are evaluated several times.
    """
    lanes, size = kernel.lanes, layout.tile_size(kernel)
    packed_size = size_of(kernel.element) * lanes
    level = None if kernel.cull is None else level_kernel(kernel.probe)
    if kernel.side_by_side:
        look, take, close = _side_by_side(kernel, scene_dtype, compact)
    else:
        look, take, close = _one_by_one(kernel, scene_dtype)
    all_points, points = rows(Vector, lanes), column(Vector, lanes)
    read_all, write_all, read = all_points.read, all_points.write, points.read
    scene_records, room_of_depths = records(scene_dtype), scratch(lanes)

    @partial(compiled, inline=True)
    def complete(table, workspace, body, place, g, address, number, live, is_first, lead):
        """Pass a tile to `finish`, and write its elements' contacts."""
        contacts = contacts_of(table)
        tile, pose = floats(address, size), pose_at(place)
        arm = read_all(tile, layout.POINT * lanes) - pose.tree
        write_all(tile, layout.ARM * lanes, arm)
        write_all(tile, layout.VELOCITY * lanes, velocity_at(pose.motion, arm))
        finish(table, workspace, body, place, g, tile, number, live, is_first, lead)
        for lane in range(lanes):
            if tile[layout.WEIGHT * lanes + lane] > 0.0:
                contact = contacts[bits_of(tile[layout.INDEX * lanes + lane])]
                contact.length = tile[(layout.SAMPLE + 1) * lanes + lane]
                write_vector(contact.point, 0, read(tile, layout.POINT * lanes + lane))
                velocity = read(tile, layout.VELOCITY * lanes + lane)
                force = read(tile, layout.FORCE * lanes + lane)
                write_vector(contact.velocity, 0, velocity)
                write_vector(contact.force, 0, force)
                contact.power = dot(force, velocity)

    @compiled
    def sample_all(table, workspace, tiles, step, lead):
        bodies = bodies_of(table)
        surface = scene_records(table[memory.SCENE], 1)[0].surface
        g = gravity_of(table)
        packed, depths = table[memory.ELEMENTS], room_of_depths()
        number, first = 0, 0
        for slot in range(len(bodies)):
            body = bodies[slot]
            place = place_of(table, body)
            around = 0.0 if level is None else level(surface, pose_at(place))
            start = number
            live = 0
            while first < body.end:
                here = min(body.end - first, lanes)
                lane = 0 if look(table, packed, first, here, around, depths) else here
                while lane < here:
                    tile = tiles + step * number
                    lane, live = take(
                        table, packed, first, lane, here, place, around, g, depths, tile, live
                    )
                    if live == lanes:
                        is_first = number == start
                        complete(
                            table, workspace, body, place, g, tile, number, live, is_first, lead
                        )
                        number += 1
                        live = 0
                packed += 8 * packed_size
                first += here
            if live > 0:
                tile = tiles + step * number
                close(table, place, g, tile, live)
                is_first = number == start
                complete(table, workspace, body, place, g, tile, number, live, is_first, lead)
                number += 1
        return number

    return sample_all


def _look_at_all(kernel: LawKernel) -> Any:
    """Make the kernel `look` for laws whose `cull` takes all lanes at once."""
    lanes, cull = kernel.lanes, kernel.cull
    read_elements, all_depths = rows(kernel.element, lanes).read, rows(float, lanes)
    write_depths = all_depths.write
    # The compiler turns a loop into scattered stores, which are slower than single ones.
    contact_size = CONTACT_DTYPE.itemsize
    stride = contact_size // 8  # the depth comes first
    read_depths, note_depths = column(lanes, 1).read, column(lanes, stride).write
    packed_size = size_of(kernel.element) * lanes

    @partial(compiled, inline=True)
    def look(table, packed, first, here, around, depths):
        deepest = cull(read_elements(floats(packed, packed_size), 0), around)
        write_depths(depths, 0, deepest)
        contacts = table[memory.CONTACTS] + contact_size * first
        if here == lanes:
            note_depths(floats(contacts, lanes * stride), 0, read_depths(depths, 0))
        else:
            for lane in range(here):
                floats(contacts + contact_size * lane, 1)[0] = depths[lane]
        return not all_of(deepest <= 0.0)

    return look


def _one_by_one(kernel: LawKernel, scene_dtype: np.dtype) -> tuple[Any, Any, Any]:
    """Make kernels `look`, `take` and `close`, for laws and surfaces that take numbers.

    `look` returns whether any element of a packed tile may be in the sand. `take` visits its
    elements, from a lane on, until the tile is full; it returns the lane to continue from, and the
    number of elements in the tile. `close` fills the unused lanes of a tile.
    """
    lanes, sample = kernel.lanes, kernel.sample
    read_element, samples = column(kernel.element, lanes).read, column(kernel.samples, lanes)
    read_sample, write_sample = samples.read, samples.write
    write_depths = rows(float, lanes).write
    scene_records = records(scene_dtype)
    packed_size, size = size_of(kernel.element) * lanes, layout.tile_size(kernel)

    @partial(compiled, inline=True)
    def look_at_none(table, packed, first, here, around, depths):
        write_depths(depths, 0, math.inf)
        return True

    look = look_at_none if kernel.cull is None else _look_at_all(kernel)

    @compiled
    def take(table, packed, first, lane, here, place, around, g, depths, address, live):
        contacts = contacts_of(table)
        scene = scene_records(table[memory.SCENE], 1)[0]
        elements, tile = floats(packed, packed_size), floats(address, size)
        while lane < here and live < lanes:
            if not depths[lane] <= 0.0:
                element = read_element(elements, lane)
                found = sample(element, pose_at(place), scene.law, scene.surface, g)
                contacts[first + lane].depth = found.depth
                if not found.depth <= 0.0:
                    write_sample(tile, layout.SAMPLE * lanes + live, found)
                    tile[layout.INDEX * lanes + live] = number_of(first + lane)
                    tile[layout.WEIGHT * lanes + live] = 1.0
                    live += 1
            lane += 1
        return lane, live

    @compiled
    def close(table, place, g, address, live):
        tile = floats(address, size)
        last = read_sample(tile, layout.SAMPLE * lanes + live - 1)
        for lane in range(live, lanes):
            write_sample(tile, layout.SAMPLE * lanes + lane, last)
            tile[layout.WEIGHT * lanes + lane] = 0.0

    return look, take, close


def _side_by_side(kernel: LawKernel, scene_dtype: np.dtype, compact: bool) -> tuple[Any, Any, Any]:
    """Make the same kernels for laws and surfaces that take all lanes at once."""
    lanes, sample, look = kernel.lanes, kernel.sample, _look_at_all(kernel)
    elements, one = rows(kernel.element, lanes), column(kernel.element, lanes)
    read_elements, read_element, write_element = elements.read, one.read, one.write
    write_samples, all_depths = rows(kernel.samples, lanes).write, rows(float, lanes)
    read_all_depths, write_all_weights = all_depths.read, all_depths.write
    scene_records = records(scene_dtype)
    packed_size, size = size_of(kernel.element) * lanes, layout.tile_size(kernel)
    gathered = layout.element_row(kernel) * lanes

    @compiled
    def sample_tile(table, array, at, place, g, tile):
        scene = scene_records(table[memory.SCENE], 1)[0]
        found = sample(read_elements(array, at), pose_at(place), scene.law, scene.surface, g)
        write_samples(tile, layout.SAMPLE * lanes, found)

    @compiled
    def take(table, packed, first, lane, here, place, around, g, depths, address, live):
        tile, found = floats(address, size), floats(packed, packed_size)
        is_dry = read_all_depths(depths, 0) <= 0.0
        is_whole = here == lanes and lane == 0 and live == 0 and count_of(is_dry) == 0
        if is_whole or not compact:
            for k in range(lanes):
                tile[layout.INDEX * lanes + k] = number_of(first + k)
            write_all_weights(tile, layout.WEIGHT * lanes, choose(is_dry, 0.0, 1.0))
            for k in range(here, lanes):
                tile[layout.WEIGHT * lanes + k] = 0.0
            sample_tile(table, found, 0, place, g, tile)
            return here, lanes
        while lane < here and live < lanes:
            if not depths[lane] <= 0.0:
                write_element(tile, gathered + live, read_element(found, lane))
                tile[layout.INDEX * lanes + live] = number_of(first + lane)
                tile[layout.WEIGHT * lanes + live] = 1.0
                live += 1
            lane += 1
        if live == lanes:
            sample_tile(table, tile, gathered, place, g, tile)
        return lane, live

    @compiled
    def close(table, place, g, address, live):
        tile = floats(address, size)
        last = read_element(tile, gathered + live - 1)
        for lane in range(live, lanes):
            write_element(tile, gathered + lane, last)
            tile[layout.WEIGHT * lanes + lane] = 0.0
        sample_tile(table, tile, gathered, place, g, tile)

    return look, take, close


@cache
def sampling_program(kernel: LawKernel, scene_dtype: np.dtype) -> Any:
    """Make the kernel of `Scheme.sampling`: it fills the workspace's tiles and sets `w.count`."""
    size, added = layout.tile_size(kernel), kernel.added
    note_momentum = None if added is None else momentum_kernel(kernel)
    charge_turns = None if added is None else turn_kernel(kernel)

    @partial(compiled, inline=True)
    def note_head(table, w, body, place, g, tile, number, live, is_first, lead):
        w.heads[number].body, w.heads[number].live = body.body, live
        if note_momentum is not None:
            note_momentum(w, body.body, tile, live, is_first)

    sample_all = sampling_kernel(kernel, scene_dtype, note_head, compact=True)

    @compiled
    def find(address, lead):
        table = memory.table_at(address)
        w = workspace_at(table[memory.WORKSPACE])
        w.h, w.count = lead, 0
        if table[memory.OFF] != 0:
            return 0
        w.count = sample_all(table, w, w.tiles.ctypes.data, 8 * size, 0.0)
        if charge_turns is not None:
            charge_turns(w)
        return w.count

    return find
