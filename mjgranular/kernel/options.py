"""The options of a model, which a user may change between any two steps.

Nothing that depends on them is stored: compiled code reads `mjOption` in place in `mjModel`.
"""

from __future__ import annotations

import ctypes
from functools import cache, partial

import mujoco
import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.memory import OPTIONS, records
from mjgranular.kernel.structs import record_of

OPTION_DTYPE = record_of("mjOption")
option_records = records(OPTION_DTYPE)
_OFFSETS = {name: int(field[1]) for name, field in (OPTION_DTYPE.fields or {}).items()}

NO_GRAVITY = int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
NO_PASSIVE_FORCES = int(mujoco.mjtDisableBit.mjDSBL_SPRING | mujoco.mjtDisableBit.mjDSBL_DAMPER)
"""With both of these disabled `mj_passive` computes nothing, not even the forces of plugins."""

DISABLEFLAGS_BEHIND_INTEGRATOR = int(_OFFSETS["disableflags"] - _OFFSETS["integrator"])  # [bytes]


def options_address(model: mujoco.MjModel) -> int:
    """Return the address of a model's `mjOption`.

    Raises:
        ImportError: the layout differs from MuJoCo's own description.
    """
    _verify()
    return _address_of(model)


@partial(compiled, inline=True)
def options_at(table):
    """Return the present options of the model, a record of `OPTION_DTYPE`."""
    return option_records(table[OPTIONS], 1)[0]


def _address_of(model: mujoco.MjModel) -> int:
    return model.opt.gravity.ctypes.data - _OFFSETS["gravity"]


@cache
def _verify() -> None:
    """Check the layout by writing numbers to the options of a small model and reading the record.

    Raises:
        ImportError: the record does not contain them.
    """
    model = mujoco.MjModel.from_xml_string("<mujoco/>")
    names = OPTION_DTYPE.names or ()
    for number, name in enumerate(names, start=2):
        if isinstance(getattr(model.opt, name), np.ndarray):
            getattr(model.opt, name)[:] = number
        else:
            setattr(model.opt, name, number)
    raw = ctypes.string_at(_address_of(model), OPTION_DTYPE.itemsize)
    found = np.frombuffer(raw, OPTION_DTYPE)[0]
    if any((found[name] != number).any() for number, name in enumerate(names, start=2)):
        raise ImportError(
            f"mjOption of MuJoCo {mujoco.mj_versionString()} is not laid out as MuJoCo describes "
            "it: mjgranular was tested with MuJoCo 3.17 and 4.0"
        )
