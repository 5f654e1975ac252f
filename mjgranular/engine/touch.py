"""Touch sensor for sand: the sum of the magnitudes of forces on elements.

MuJoCo's touch sensor sums the normal forces of contacts within a site's volume. Sand makes no
contacts. Instead the magnitudes of the forces on elements are summed, for a geom or within a site:
forces that press on two sides of a body do not cancel.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import mujoco

from mjgranular.engine.block import HEADER_DTYPE
from mjgranular.engine.layout import Layout
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.memory import CONTACTS, ELEMENT_COUNT, longs, records, row_of, table_at
from mjgranular.kernel.records import contact_records

_header = records(HEADER_DTYPE)

_SPHERE = int(mujoco.mjtGeom.mjGEOM_SPHERE)
_CAPSULE = int(mujoco.mjtGeom.mjGEOM_CAPSULE)
_ELLIPSOID = int(mujoco.mjtGeom.mjGEOM_ELLIPSOID)
_CYLINDER = int(mujoco.mjtGeom.mjGEOM_CYLINDER)


@compiled
def is_inside(kind, size, x, y, z):
    """Return True if a point in the frame of a site is inside its volume.

    Args:
        kind: type of the site: sphere, capsule, ellipsoid, cylinder, else box.
        size: size of the site, 3 numbers.
        x: coordinate of the point [m].
        y: coordinate of the point [m].
        z: coordinate of the point [m].
    """
    if kind == _SPHERE:
        return x * x + y * y + z * z <= size[0] * size[0]
    if kind == _CAPSULE:
        beyond = max(abs(z) - size[1], 0.0)
        return x * x + y * y + beyond * beyond <= size[0] * size[0]
    if kind == _ELLIPSOID:
        return (x / size[0]) ** 2 + (y / size[1]) ** 2 + (z / size[2]) ** 2 <= 1.0
    if kind == _CYLINDER:
        return x * x + y * y <= size[0] * size[0] and abs(z) <= size[1]
    return abs(x) <= size[0] and abs(y) <= size[1] and abs(z) <= size[2]


@cache
def touch_sensor(layout: Layout) -> Any:
    """Make a compiled function `touch(data, block, row)`: the sum [N] for a `READING_DTYPE` row."""
    site_xpos, site_xmat = layout.site_xpos, layout.site_xmat

    @compiled
    def touch(data, block, row):
        header = _header(block, 1)[0]
        table = table_at(header.table)
        contacts = contact_records(table[CONTACTS], table[ELEMENT_COUNT])
        slots, geoms = longs(header.slots, len(contacts)), longs(header.geoms, len(contacts))
        number = max(row.site, 0)
        place = row_of(longs(data + site_xpos, 1)[0], number, 3)
        turn = row_of(longs(data + site_xmat, 1)[0], number, 9)
        total = 0.0
        for i in range(len(contacts)):
            contact = contacts[i]
            mine = row.slot < 0 or row.slot == slots[i]
            mine = mine and (row.geom < 0 or row.geom == geoms[i]) and contact.depth > 0.0
            if mine and row.site >= 0:
                a, b, c = (
                    contact.point[0] - place[0],
                    contact.point[1] - place[1],
                    contact.point[2] - place[2],
                )
                mine = is_inside(
                    row.kind,
                    row.size,
                    turn[0] * a + turn[3] * b + turn[6] * c,
                    turn[1] * a + turn[4] * b + turn[7] * c,
                    turn[2] * a + turn[5] * b + turn[8] * c,
                )
            if mine:
                force = contact.force
                total += math.sqrt(force[0] * force[0] + force[1] * force[1] + force[2] * force[2])
        return total

    return touch
