"""The explicit scheme's loop over elements side by side (`law.kernel.Sheets`)."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from mjgranular.kernel.compiled import compiled
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
    summed,
)
from mjgranular.kernel.motion import velocity_at, velocity_change
from mjgranular.kernel.records import CONTACT_DTYPE, body_records, contact_records
from mjgranular.law.kernel import WORLD, LawKernel
from mjgranular.scheme.wrenches import gravity_of, place_of, pose_at

# Rows of a block: velocity of the point, and that for drag [m/s]; force; what `immerse` gave;
# wrench about the body's centre of mass, summed over the body's sheets.
_VELOCITY, _DRAG, _FORCE, _WRENCH, _IMMERSED = 0, 3, 6, 9, 15
_POINT = _IMMERSED + 2
CONTACT_SIZE = CONTACT_DTYPE.itemsize


def look_kernel(kernel: LawKernel) -> Any:
    """Makes a kernel `look(sheet, level, depths, contacts, live)`.

    It notes the depths of a sheet's elements, also in so many contacts at that address; how many
    elements are in the sand, those of lanes left over among them.
    """
    assert kernel.sheets is not None
    assert kernel.lanes == 8
    skim = kernel.sheets.skim
    stride = CONTACT_DTYPE.itemsize // 8  # the depth comes first
    parts = {count: (column(count, 1).read, column(count, stride).write) for count in (8, 4, 2, 1)}
    (read_8, write_8), (read_4, write_4), (read_2, write_2), (read_1, write_1) = parts.values()

    @compiled
    def look(sheet, level, depths, contacts, live):
        wet = skim(sheet, level, depths)
        # Of a loop the compiler makes scattered stores, which take longer than single ones.
        numbers = floats(contacts, stride * live)
        if live == 8:
            write_8(numbers, 0, read_8(depths, 0))
            return wet
        lane = 0
        if live & 4:
            write_4(numbers, 0, read_4(depths, 0))
            lane = 4
        if live & 2:
            write_2(numbers, stride * lane, read_2(depths, lane))
            lane += 2
        if live & 1:
            write_1(numbers, stride * lane, read_1(depths, lane))
        return wet

    return look


def forces_on_sheets(kernel: LawKernel, scene_dtype: np.dtype) -> Any:
    """Makes a kernel `forces(table, lead)`: wrenches of bodies, contacts of elements."""
    sheets, level, lanes = kernel.sheets, kernel.level, kernel.lanes
    assert sheets is not None
    look, size = look_kernel(kernel), sheets.rows * lanes
    immerse = sheets.immerse(_IMMERSED * lanes)
    resist = sheets.resist(*(row * lanes for row in (_IMMERSED, _VELOCITY, _DRAG, _FORCE)))
    scene_records = records(scene_dtype)
    room = scratch((_IMMERSED + 5 + kernel.numbers) * lanes)
    room_of_depths = scratch(lanes)
    three, six, total = rows(3, lanes), rows(6, lanes), summed(lanes)
    read, write, read_six, write_six = three.read, three.write, six.read, six.write
    read_contact, write_contact = column(3, lanes).read, column(3, 1).write

    @compiled
    def move(block, pose, change):
        """Velocities of the points."""
        tx, ty, tz = pose.tree
        x, y, z = read(block, _POINT * lanes)
        x, y, z = x - tx, y - ty, z - tz
        vx, vy, vz = velocity_at(pose.motion, x, y, z)
        # Drag takes the velocity ahead, static resistance the direction of the velocity
        # now: led as well, it creeps five times faster under load.
        cx, cy, cz = velocity_at(change, x, y, z)
        write(block, _VELOCITY * lanes, (vx, vy, vz))
        write(block, _DRAG * lanes, (vx + cx, vy + cy, vz + cz))

    @compiled
    def add(block, pose):
        """Adds the forces to the wrench."""
        ix, iy, iz = pose.com
        x, y, z = read(block, _POINT * lanes)
        x, y, z = x - ix, y - iy, z - iz
        fx, fy, fz = read(block, _FORCE * lanes)
        a, b, c, d, e, f = read_six(block, _WRENCH * lanes)
        a, b, c = a + fx, b + fy, c + fz
        d, e, f = d + (y * fz - z * fy), e + (z * fx - x * fz), f + (x * fy - y * fx)
        write_six(block, _WRENCH * lanes, (a, b, c, d, e, f))

    @compiled
    def tell(block, lane, contact):
        """Writes a contact."""
        contact.length = 0.0
        px, py, pz = read_contact(block, _POINT * lanes + lane)
        vx, vy, vz = read_contact(block, _VELOCITY * lanes + lane)
        fx, fy, fz = read_contact(block, _FORCE * lanes + lane)
        write_contact(contact.point, 0, (px, py, pz))
        write_contact(contact.velocity, 0, (vx, vy, vz))
        write_contact(contact.force, 0, (fx, fy, fz))

    @partial(compiled, inline=True)
    def forces(table, lead):
        contacts = contact_records(table[CONTACTS], table[ELEMENT_COUNT])
        bodies = body_records(table[BODIES], table[BODY_COUNT])
        scene = scene_records(table[SCENE], 1)
        law = scene[0].law
        surface = scene[0].surface
        g = gravity_of(table)
        block, depths = room(), room_of_depths()
        ux, uy, uz, _ = level(surface, WORLD)
        address, address_of_contacts = table[ELEMENTS], table[CONTACTS]
        first = 0
        change = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        for slot in range(len(bodies)):
            body = bodies[slot]
            for k in range(6):
                body.wrench[k] = 0.0
            place = place_of(table, body)
            around = level(surface, pose_at(place))
            dry = True
            while first < body.end:
                sheet = floats(address, size)
                address += 8 * size
                live = min(body.end - first, lanes)
                if look(sheet, around, depths, address_of_contacts, live) > 0:
                    if dry:  # most bodies of a robot are above the sand
                        dry = False
                        change = velocity_change(table, body.last_dof, lead)
                        write_six(block, _WRENCH * lanes, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
                    pose = pose_at(place)
                    immerse(sheet, pose, around, (ux, uy, uz), law, g, block)
                    move(block, pose, change)
                    resist(block, law, g)
                    add(block, pose)
                    for lane in range(live):
                        if not depths[lane] <= 0.0:
                            tell(block, lane, contacts[first + lane])
                first += live
                address_of_contacts += CONTACT_SIZE * live
            if not dry:
                for k in range(6):
                    body.wrench[k] = total(block, (_WRENCH + k) * lanes)

    return forces
