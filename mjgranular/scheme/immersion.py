"""The implicit scheme's look at where elements are: those in the sand fill its blocks."""

from __future__ import annotations

from typing import Any

import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.elementary import bits_of, number_of
from mjgranular.kernel.lanes import rows
from mjgranular.kernel.memory import (
    BODIES,
    BODY_COUNT,
    CONTACTS,
    ELEMENT_COUNT,
    ELEMENTS,
    SCENE,
    column,
    floats,
    records,
    scratch,
)
from mjgranular.kernel.motion import velocity_at
from mjgranular.kernel.records import body_records, contact_records
from mjgranular.law.kernel import WORLD, LawKernel
from mjgranular.scheme.layout import (
    ARM,
    IMMERSED,
    INDEX,
    VELOCITY,
    WEIGHT,
    block_size,
)
from mjgranular.scheme.sheets import CONTACT_SIZE, look_kernel
from mjgranular.scheme.wrenches import gravity_of, place_of, pose_at


def immerse_kernel(kernel: LawKernel, scene_dtype: np.dtype) -> Any:
    """See `BlockKernels.immerse`."""
    if kernel.sheets is not None:
        return gather_kernel(kernel, scene_dtype)
    element_records, scene_records = kernel.elements, records(scene_dtype)
    immerse, lanes, size = kernel.immerse, kernel.lanes, block_size(kernel)
    level, skim = kernel.level, kernel.skim
    three, numbers = column(3, lanes), column(5 + kernel.numbers, lanes)
    write_three, write_numbers = three.write, numbers.write
    rows = size // lanes

    @compiled
    def fill(block, live):
        for lane in range(live, lanes):
            for row in range(rows):
                block[row * lanes + lane] = block[row * lanes + live - 1]
            block[WEIGHT * lanes + lane] = 0.0

    @compiled
    def immerse_all(table, w):
        elements = element_records(table[ELEMENTS], table[ELEMENT_COUNT])
        contacts = contact_records(table[CONTACTS], table[ELEMENT_COUNT])
        bodies = body_records(table[BODIES], table[BODY_COUNT])
        heads, blocks = w.heads, w.blocks
        scene = scene_records(table[SCENE], 1)
        law = scene[0].law
        surface = scene[0].surface
        g = gravity_of(table)
        block = blocks[0]
        count = 0
        first = 0
        for slot in range(len(bodies)):
            body = bodies[slot]
            place = place_of(table, body)
            around = level(surface, pose_at(place))
            live = 0
            for i in range(first, body.end):
                element, contact = elements[i], contacts[i]
                depth = skim(element, around)
                if depth <= 0.0:
                    contact.depth = depth
                    continue
                pose = pose_at(place)  # anew: numbers kept from above would cost more
                immersed = immerse(element, pose, law, surface, g)
                contact.depth = immersed[0]
                if immersed[0] <= 0.0:
                    continue
                contact.length = immersed[1]
                x, y, z = immersed[2], immersed[3], immersed[4]
                contact.point[0], contact.point[1], contact.point[2] = x, y, z
                tx, ty, tz = pose.tree
                x, y, z = x - tx, y - ty, z - tz
                v = velocity_at(pose.motion, x, y, z)
                contact.velocity[0], contact.velocity[1], contact.velocity[2] = v[0], v[1], v[2]
                if live == 0:
                    block = blocks[count]
                    heads[count].body = body.body
                    count += 1
                write_three(block, ARM * lanes + live, (x, y, z))
                write_three(block, VELOCITY * lanes + live, v)
                write_numbers(block, IMMERSED * lanes + live, immersed)
                block[WEIGHT * lanes + live] = 1.0
                block[INDEX * lanes + live] = number_of(i)
                live += 1
                heads[count - 1].live = live
                if live == lanes:
                    live = 0
            if live > 0:
                fill(block, live)
            first = body.end
        return count

    return immerse_all


def gather_kernel(kernel: LawKernel, scene_dtype: np.dtype) -> Any:
    """The same for elements that lie in sheets: what is in the sand of them is put together."""
    sheets, level, lanes = kernel.sheets, kernel.level, kernel.lanes
    assert sheets is not None
    sheet_size = sheets.rows * lanes
    scene_records, look = records(scene_dtype), look_kernel(kernel)
    immerse = sheets.immerse(IMMERSED * lanes)
    element, three = column(sheets.rows, lanes), rows(3, lanes)
    read_element, write_element = element.read, element.write
    read, write = three.read, three.write
    read_three, write_three = column(3, lanes).read, column(3, 1).write
    room_of_depths, room_of_gathered = scratch(lanes), scratch(sheet_size)

    @compiled
    def put(block, gathered, live, place, around, up, law, g):
        """Fills a block with so many elements that have been put together, all of one body."""
        last = read_element(gathered, live - 1)
        for lane in range(live, lanes):
            write_element(gathered, lane, last)
            block[INDEX * lanes + lane] = block[INDEX * lanes + live - 1]
        for lane in range(lanes):
            block[WEIGHT * lanes + lane] = 1.0 if lane < live else 0.0
        pose = pose_at(place)
        immerse(gathered, pose, around, up, law, g, block)
        tx, ty, tz = pose.tree
        x, y, z = read(block, (IMMERSED + 2) * lanes)
        x, y, z = x - tx, y - ty, z - tz
        write(block, ARM * lanes, (x, y, z))
        write(block, VELOCITY * lanes, velocity_at(pose.motion, x, y, z))

    @compiled
    def tell(block, live, contacts):
        """Writes what is known of contacts before their forces."""
        for lane in range(live):
            contact = contacts[bits_of(block[INDEX * lanes + lane])]
            contact.length = block[(IMMERSED + 1) * lanes + lane]
            write_three(contact.point, 0, read_three(block, (IMMERSED + 2) * lanes + lane))
            write_three(contact.velocity, 0, read_three(block, VELOCITY * lanes + lane))

    @compiled
    def immerse_all(table, w):
        contacts = contact_records(table[CONTACTS], table[ELEMENT_COUNT])
        bodies = body_records(table[BODIES], table[BODY_COUNT])
        heads, blocks = w.heads, w.blocks
        scene = scene_records(table[SCENE], 1)
        law = scene[0].law
        surface = scene[0].surface
        g = gravity_of(table)
        ux, uy, uz, _ = level(surface, WORLD)
        up = (ux, uy, uz)
        block, depths, gathered = blocks[0], room_of_depths(), room_of_gathered()
        sheet_address, told = table[ELEMENTS], table[CONTACTS]
        count = 0
        first = 0
        for slot in range(len(bodies)):
            body = bodies[slot]
            place = place_of(table, body)
            around = level(surface, pose_at(place))
            live = 0
            while first < body.end:
                sheet = floats(sheet_address, sheet_size)
                sheet_address += 8 * sheet_size
                here = min(body.end - first, lanes)
                wet = look(sheet, around, depths, told, here)
                told += CONTACT_SIZE * here
                if wet > 0:
                    for lane in range(here):
                        if depths[lane] <= 0.0:
                            continue
                        if live == 0:
                            block = blocks[count]
                            heads[count].body = body.body
                            count += 1
                        write_element(gathered, live, read_element(sheet, lane))
                        block[INDEX * lanes + live] = number_of(first + lane)
                        live += 1
                        heads[count - 1].live = live
                        if live == lanes:
                            put(block, gathered, live, place, around, up, law, g)
                            tell(block, live, contacts)
                            live = 0
                first += here
            if live > 0:
                put(block, gathered, live, place, around, up, law, g)
                tell(block, live, contacts)
        return count

    return immerse_all
