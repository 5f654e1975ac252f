"""The plugin `mjgranular.sensor`: effects of the sand on a body, among MuJoCo's own sensors.

It reads the results of the sand in the same `mjData`. It is a separate plugin so that a model
without such sensors does not pay for them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import mujoco
import numpy as np

from mjgranular.engine.block import HEADER_DTYPE
from mjgranular.engine.handles import block_finder
from mjgranular.engine.layout import Layout
from mjgranular.engine.measures import MEASURES
from mjgranular.engine.touch import touch_sensor
from mjgranular.engine.trampolines import UNPREPARED
from mjgranular.errors import InputError, UnknownNameError, listed
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.machine import c_function
from mjgranular.kernel.memory import (
    BODIES,
    BODY_COUNT,
    CONTACTS,
    ELEMENT_COUNT,
    floats,
    longs,
    records,
    table_at,
)
from mjgranular.kernel.records import body_records, contact_records

FORCE, MOMENT, DEPTH, POWER, SPEED, TOUCH = range(len(MEASURES))

READING_DTYPE = np.dtype(
    [
        ("sand", np.int64),  # instance whose results are read
        ("measure", np.int64),
        ("slot", np.int64),  # row of the body in the sand, -1 for all bodies together
        ("at", np.int64),  # index of its first value in `sensordata`
        ("geom", np.int64),  # only elements of this geom count, -1 for all
        ("site", np.int64),  # only elements inside this site count, -1 for anywhere
        ("kind", np.int64),  # of that site
        ("size", np.float64, (3,)),  # of that site [m]
    ]
)

_header = records(HEADER_DTYPE)
_readings = records(READING_DTYPE)
_unprepared = c_function(UNPREPARED, "void", "int64")

_UNKNOWN = int(mujoco.mjtObj.mjOBJ_UNKNOWN)
_BODIES = (int(mujoco.mjtObj.mjOBJ_BODY), int(mujoco.mjtObj.mjOBJ_XBODY))
_GEOM, _SITE = int(mujoco.mjtObj.mjOBJ_GEOM), int(mujoco.mjtObj.mjOBJ_SITE)


@dataclass(frozen=True)
class Sensors:
    """The sensors of a model, as far as needed: arrays of `mjModel` without `sensor_`."""

    plugin: np.ndarray
    objtype: np.ndarray
    objid: np.ndarray
    adr: np.ndarray


@dataclass(frozen=True)
class Sites:
    """The sites of a model: arrays of `mjModel` without `site_`."""

    bodyid: np.ndarray
    type: np.ndarray
    size: np.ndarray


def find_sand(name: str, sands: Mapping[str, int]) -> int:
    """Return the index of the instance that a sensor reads.

    Args:
        name: name of the instance; "" for the only one.
        sands: instances of `mjgranular.sand` by name.

    Raises:
        InputError: no such instance, or no name although there are several.
    """
    if not name and len(sands) == 1:
        (only,) = sands.values()
        return only
    if not sands:
        raise InputError("there is no instance of mjgranular.sand in the model")
    if not name:
        raise InputError(f"config 'sand': the model has several sands: name one of {listed(sands)}")
    if name not in sands:
        raise InputError(f"config 'sand': {UnknownNameError('sand', name, sands)}")
    return sands[name]


def make_readings(
    instance: int,
    sand: int,
    measure: str,
    sensors: Sensors,
    sites: Sites,
    bodies: Mapping[int, str],
    geoms: Mapping[int, str],
) -> np.ndarray:
    """Make the list of what one instance measures: rows of `READING_DTYPE`.

    Args:
        instance: index of the instance of this plugin.
        sand: index of the instance of the sand.
        measure: name of the measure.
        sensors: sensors of the model.
        sites: sites of the model.
        bodies: names of the sand's bodies by their ids, in its order.
        geoms: names of the geoms that have its elements, by their ids.

    Raises:
        InputError: no such measure, or a body or geom that does not meet that sand.
    """
    if measure not in MEASURES:
        raise InputError(f"config 'measure': {UnknownNameError('measure', measure, MEASURES)}")
    kind = list(MEASURES).index(measure)
    mine = np.flatnonzero(sensors.plugin == instance)
    rows = np.zeros(len(mine), READING_DTYPE)
    for row, number in zip(rows, mine, strict=True):
        row["sand"], row["measure"], row["at"] = sand, kind, sensors.adr[number]
        row["slot"] = row["geom"] = row["site"] = -1
        objtype, object = int(sensors.objtype[number]), int(sensors.objid[number])
        if objtype in _BODIES:
            row["slot"] = _place("body", object, bodies)
        elif objtype == _GEOM and kind == TOUCH:
            _place("geom", object, geoms)
            row["geom"] = object
        elif objtype == _SITE and kind == TOUCH:
            row["slot"] = _place("body", int(sites.bodyid[object]), bodies)
            row["site"], row["kind"] = object, sites.type[object]
            row["size"] = sites.size[3 * object : 3 * object + 3]
        elif objtype != _UNKNOWN:
            others = "body, geom or site" if kind == TOUCH else "body"
            raise InputError(f"objtype must be {others}, or left out for all bodies together")
        if kind == MOMENT and row["slot"] < 0:
            raise InputError(
                "a moment is about the centre of mass of one body: objtype and objname"
            )
    return rows


def _place(kind: str, number: int, names: Mapping[int, str]) -> int:
    """Return the index of a body or geom among those that meet a sand.

    Raises:
        InputError: it does not meet the sand; lists those that do.
    """
    if number not in names:
        raise InputError(
            f"objname: {kind} number {number} does not meet the sand; those that do: "
            f"{listed(names.values())}"
        )
    return list(names).index(number)


@compiled
def measure_sand(block, measure, slot, values):
    """Compute a measure from the results of a sand's last step.

    Args:
        block: block of the sand.
        measure: index of the measure.
        slot: row of the body, -1 for all.
        values: array for the result.
    """
    header = _header(block, 1)[0]
    table = table_at(header.table)
    if measure in (FORCE, MOMENT):
        bodies = body_records(table[BODIES], table[BODY_COUNT])
        first = 3 if measure == MOMENT else 0
        for k in range(3):
            values[k] = 0.0
        for i in range(len(bodies)):
            if slot < 0 or slot == i:
                for k in range(3):
                    values[k] += bodies[i].wrench[first + k]
        return
    contacts = contact_records(table[CONTACTS], table[ELEMENT_COUNT])
    slots = longs(header.slots, len(contacts))
    depth, power, square = -math.inf, 0.0, 0.0
    for i in range(len(contacts)):
        if slot < 0 or slot == slots[i]:
            contact = contacts[i]
            depth = max(depth, contact.depth)
            if contact.depth > 0.0:  # above the sand only the depth is written
                speed = 0.0
                for k in range(3):
                    power += contact.force[k] * contact.velocity[k]
                    speed += contact.velocity[k] * contact.velocity[k]
                square = max(square, speed)
    if measure == SPEED:
        values[0] = math.sqrt(square)
    else:
        values[0] = depth if measure == DEPTH else power


@cache
def sensor_compute(layout: Layout) -> Any:
    """Make the compiled `compute` of the plugin."""
    find_block, touch = block_finder(layout), touch_sensor(layout)
    sensordata = layout.sensordata
    begin, stride = HEADER_DTYPE.itemsize, READING_DTYPE.itemsize

    @compiled
    def compute(model, data, instance, capability):
        block = find_block(data, instance)
        if block == 0:
            _unprepared(data)
            return
        if _header(block, 1)[0].size == 0:
            return
        rows = _readings(block + begin, (_header(block, 1)[0].size - begin) // stride)
        readings = longs(data + sensordata, 1)[0]
        for i in range(len(rows)):
            row = rows[i]
            sand = find_block(data, row.sand)
            if sand != 0 and _header(sand, 1)[0].table != 0:
                size = 3 if row.measure in (FORCE, MOMENT) else 1
                values = floats(readings + 8 * row.at, size)
                if row.measure == TOUCH:
                    values[0] = touch(data, sand, row)
                else:
                    measure_sand(sand, row.measure, row.slot, values)

    return compute
