"""The plugin `mjgranular.sensor`: effects of the sand on a body, among MuJoCo's own sensors.

It reads the results of the sand in the same `mjData`. It is a separate plugin so that a model
without such sensors does not pay for them. `SandReadings` reads them from Python instead.
"""

import math
from collections.abc import Callable, Mapping

import mujoco
import numpy as np

from mjgranular.engine.block import HEADER_DTYPE, header_at
from mjgranular.engine.config import MEASURES
from mjgranular.engine.external import ASLEEP
from mjgranular.engine.handles import find_block
from mjgranular.engine.instances import instance_of
from mjgranular.engine.trampolines import UNPREPARED
from mjgranular.errors import InputError, UnknownNameError, listed
from mjgranular.kernel.compiled import compiled, entry
from mjgranular.kernel.engine import is_inside_site
from mjgranular.kernel.intrinsics import c_function
from mjgranular.kernel.memory import NBODY, field, floats, ints, longs, records, table_at
from mjgranular.kernel.records import bodies_of, contacts_of
from mjgranular.kernel.vector import dot, norm, read_vector, vector, write_vector

FORCE, MOMENT, DEPTH, POWER, SPEED, TOUCH = range(len(MEASURES))

READING_DTYPE = np.dtype(
    [
        ("sand", np.int64),  # instance whose results are read
        ("measure", np.int64),
        ("slot", np.int64),  # row of the body in the sand, -1 for all bodies together
        ("at", np.int64),  # index of its first value in `sensordata`
        ("geom", np.int64),  # only elements of this geom count, -1 for all
        ("site", np.int64),  # only elements inside this site count, -1 for anywhere
    ]
)

_readings = records(READING_DTYPE)
_unprepared = c_function(UNPREPARED, "void", "int64", "int64", "int32", "int32")
_values = field("mjData", "sensordata")

_BEGIN, _STRIDE = HEADER_DTYPE.itemsize, READING_DTYPE.itemsize
_UNKNOWN = int(mujoco.mjtObj.mjOBJ_UNKNOWN)
_BODIES = (int(mujoco.mjtObj.mjOBJ_BODY), int(mujoco.mjtObj.mjOBJ_XBODY))
_GEOM, _SITE = int(mujoco.mjtObj.mjOBJ_GEOM), int(mujoco.mjtObj.mjOBJ_SITE)


def find_sand(name: str, sands: Mapping[str, int]) -> int:
    """Return the index of the instance that a sensor reads, by its name; "" is the only one."""
    if not name and len(sands) == 1:
        (only,) = sands.values()
        return only
    if name not in sands:
        raise InputError(f"config 'sand': {UnknownNameError('sand in the model', name, sands)}")
    return sands[name]


def make_readings(
    instance: int,
    sand: int,
    measure: str,
    array: Callable[[str], np.ndarray],
    bodies: Mapping[int, str],
    geoms: Mapping[int, str],
) -> np.ndarray:
    """Make the list of what one instance measures: rows of `READING_DTYPE`."""
    if measure not in MEASURES:
        raise InputError(f"config 'measure': {UnknownNameError('measure', measure, MEASURES)}")
    kind = list(MEASURES).index(measure)
    mine = np.flatnonzero(array("sensor_plugin") == instance)
    types, ids, frames = (array(f"sensor_{key}") for key in ("objtype", "objid", "reftype"))
    rows = np.zeros(len(mine), READING_DTYPE)
    for row, number in zip(rows, mine, strict=True):
        row["sand"], row["measure"], row["at"] = sand, kind, array("sensor_adr")[number]
        row["slot"] = row["geom"] = row["site"] = -1
        objtype, object = int(types[number]), int(ids[number])
        if objtype in _BODIES:
            row["slot"] = _place("body", object, bodies)
        elif objtype == _GEOM and kind == TOUCH:
            _place("geom", object, geoms)
            row["slot"] = _place("body", int(array("geom_bodyid")[object]), bodies)
            row["geom"] = object
        elif objtype == _SITE and kind == TOUCH:
            row["slot"] = _place("body", int(array("site_bodyid")[object]), bodies)
            row["site"] = object
        elif objtype != _UNKNOWN:
            others = "body, geom or site" if kind == TOUCH else "body"
            raise InputError(f"objtype must be {others}; omit it for all bodies together")
        if kind == MOMENT and row["slot"] < 0:
            raise InputError("a moment is about a body's center of mass: give objtype and objname")
        if frames[number] != _UNKNOWN:
            raise InputError("forces and moments are in world axes: omit reftype and refname")
    return rows


def _place(kind: str, number: int, names: Mapping[int, str]) -> int:
    """Return the index of a body or geom among those that meet a sand."""
    if number not in names:
        raise InputError(
            f"objname: {kind} number {number} does not meet the sand; those that do: "
            f"{listed(names.values())}"
        )
    return list(names).index(number)


@compiled
def measure_sand(block, measure, slot, values):
    """Compute a measure from the results of a sand's last step.

    The slot is the row of a body, -1 for all; the result is written to `values`.
    """
    header = header_at(block)
    table = table_at(header.table)
    if measure in (FORCE, MOMENT):
        bodies, total = bodies_of(table), vector(0.0, 0.0, 0.0)
        for i in range(len(bodies)):
            if slot < 0 or slot == i:
                total += read_vector(bodies[i].wrench, 3 if measure == MOMENT else 0)
        write_vector(values, 0, total)
        return
    contacts = contacts_of(table)
    slots = longs(header.slots, len(contacts))
    depth, power, square = -math.inf, 0.0, 0.0
    for i in range(len(contacts)):
        if slot < 0 or slot == slots[i]:
            contact = contacts[i]
            depth = max(depth, contact.depth)
            if contact.depth > 0.0:  # above the sand only the depth is written
                power += contact.power
                velocity = read_vector(contact.velocity, 0)
                square = max(square, dot(velocity, velocity))
    if measure == SPEED:
        values[0] = math.sqrt(square)
    else:
        values[0] = depth if measure == DEPTH else power


@compiled
def touch(model, data, block, row):
    """Return the sum of the magnitudes of forces [N] for a row of `READING_DTYPE`.

    As MuJoCo's touch sensor sums the normal forces of contacts, this sums the forces on elements of
    a geom or within a site: forces that press on two sides of a body do not cancel.
    """
    header = header_at(block)
    table = table_at(header.table)
    contacts = contacts_of(table)
    slots, geoms = longs(header.slots, len(contacts)), longs(header.geoms, len(contacts))
    total = 0.0
    for i in range(len(contacts)):
        contact = contacts[i]
        mine = row.slot < 0 or row.slot == slots[i]
        mine = mine and (row.geom < 0 or row.geom == geoms[i]) and contact.depth > 0.0
        if mine and row.site >= 0:
            mine = is_inside_site(model, data, row.site, contact.point.ctypes.data) != 0
        if mine:
            total += norm(read_vector(contact.force, 0))
    return total


@compiled
def is_asleep(block, slot):
    """Return True if MuJoCo skips the tree of a body; its readings stay, as those of MuJoCo do."""
    header = header_at(block)
    table = table_at(header.table)
    return slot >= 0 and ints(header.awake, table[NBODY])[bodies_of(table)[slot].body] == ASLEEP


@compiled
def compute_sensors(model, data, instance, capability):
    """Compute the values of an instance: `compute` of the plugin."""
    block = find_block(data, instance)
    if block == 0:
        _unprepared(model, data, instance, capability)
        return
    if header_at(block).size == 0:
        return
    rows = _readings(block + _BEGIN, (header_at(block).size - _BEGIN) // _STRIDE)
    for i in range(len(rows)):
        row = rows[i]
        sand = find_block(data, row.sand)
        if sand != 0 and header_at(sand).table != 0 and not is_asleep(sand, row.slot):
            size = 3 if row.measure in (FORCE, MOMENT) else 1
            values = floats(_values(data) + 8 * row.at, size)
            if row.measure == TOUCH:
                values[0] = touch(model, data, sand, row)
            else:
                measure_sand(sand, row.measure, row.slot, values)


READINGS = 6
"""Numbers of `SandReadings` per sand: force [N], depth [m], power [W], speed [m/s]."""


class SandReadings:
    """Read the last step's results of each sand for all bodies together, into one array.

    `values` has `READINGS` numbers for each sand, in the order of instances, shape (1, n);
    `together` has the index of the first number of each.
    """

    def __init__(self, model: mujoco.MjModel, sands: tuple[str, ...]) -> None:
        self._instances = [instance_of(model, name) for name in sands]
        self.together = [READINGS * number for number in range(len(sands))]
        self.values = np.zeros((1, READINGS * len(sands)))
        self._read = entry(_read, "int64(int64, int64, int64)")

    def read(self, data: mujoco.MjData) -> np.ndarray:
        """Read a simulation; zeros before its first step, and after a reset."""
        begin, address = self.values.ctypes.data, data._address
        for instance, together in zip(self._instances, self.together, strict=True):
            self._read(address, instance, begin + 8 * together)
        return self.values


@compiled
def _read(data, instance, together):
    block = find_block(data, instance)
    if block == 0 or header_at(block).table == 0:
        return 0
    measure_sand(block, FORCE, -1, floats(together, 3))
    measure_sand(block, DEPTH, -1, floats(together + 24, 1))
    measure_sand(block, POWER, -1, floats(together + 32, 1))
    measure_sand(block, SPEED, -1, floats(together + 40, 1))
    return 1
