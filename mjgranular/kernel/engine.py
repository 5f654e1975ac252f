"""MuJoCo's own functions and constraint rows, for kernels that call the engine during a step.

Cached machine code must not contain addresses. Functions are called by name, resolved when the code
is loaded, and fields of `mjData` by their offsets, which are measured on a small model and compared
with MuJoCo's Python arrays.
"""

from __future__ import annotations

import ctypes
import sys
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco.introspect.structs import STRUCTS

from mjgranular.kernel.machine import c_function, publish_functions
from mjgranular.kernel.structs import record_of

_PATTERN = {"win32": "mujoco.dll", "darwin": "libmujoco*.dylib"}.get(sys.platform, "libmujoco.so*")


@cache
def library() -> ctypes.CDLL:
    """Return the library that `import mujoco` has loaded.

    Raises:
        ImportError: it is not in the directory of the Python package `mujoco`.
    """
    folder = Path(str(mujoco.__file__)).parent
    found = sorted(folder.glob(_PATTERN))
    if not found:
        raise ImportError(f"MuJoCo's library {_PATTERN} is not in {folder}")
    return ctypes.CDLL(str(found[0]))


def _function(name: str, *arguments: str, result: str = "void") -> Any:
    """Return a function of the engine; pointers are passed as integers."""
    publish_functions(library(), [name])
    return c_function(name, result, *arguments)


_ADDRESS, _INT = "int64", "int32"
forward_actuation = _function("mj_fwdActuation", _ADDRESS, _ADDRESS)
forward_acceleration = _function("mj_fwdAcceleration", _ADDRESS, _ADDRESS)
bias_forces = _function("mj_rne", _ADDRESS, _ADDRESS, _INT, _ADDRESS)
tendon_bias_forces = _function("mj_tendonBias", _ADDRESS, _ADDRESS, _ADDRESS)
constraint_references = _function("mj_referenceConstraint", _ADDRESS, _ADDRESS)
forward_constraint = _function("mj_fwdConstraint", _ADDRESS, _ADDRESS)
forces_on_bodies = _function("mj_rnePostConstraint", _ADDRESS, _ADDRESS)
sensors_of_acceleration = _function("mj_sensorAcc", _ADDRESS, _ADDRESS)
solve_inertia = _function("mj_solveM", _ADDRESS, _ADDRESS, _ADDRESS, _ADDRESS, _INT)
smooth_derivative = _function("mjd_smooth_vel", _ADDRESS, _ADDRESS, _INT)
is_sparse = _function("mj_isSparse", _ADDRESS, result=_INT)
actuator_damping = _function("mj_actuatorDamping", _ADDRESS, _INT, _INT, _ADDRESS, result="float64")
# For the integrator `discrete`. Inverse dynamics computes metric and constraint rows without
# calling the user's controller.
inverse_dynamics = _function("mj_inverseSkip", _ADDRESS, _ADDRESS, _INT, _INT)
metric_shift = _function("mj_effShift", _ADDRESS, _ADDRESS)
add_metric_product = _function("mj_effMulAdd", _ADDRESS, _ADDRESS, _ADDRESS, _ADDRESS, _INT)
factor_inertia = _function("mj_factorI", *2 * (_ADDRESS,), _INT, *4 * (_ADDRESS,))
turns_freely = _function("mjd_freeGyroPossible", _ADDRESS, _ADDRESS, _INT, result=_INT)
free_bias_derivative = _function("mjd_freeBias_vel", _ADDRESS, _ADDRESS, _INT, _ADDRESS)


# Offsets in `mjData` of the pointers to its constraint rows [bytes], and the size of a contact. The
# rows are in an arena whose layout changes at every step, so the pointers are read at every step.
_POINTERS = {
    "contact": "contact",
    "kind": "efc_type",
    "owner": "efc_id",
    "row_size": "efc_J_rownnz",
    "row_start": "efc_J_rowadr",
    "column": "efc_J_colind",
    "jacobian": "efc_J",
    "loss": "efc_frictionloss",
    "mass": "efc_D",
    "reference": "efc_aref",
    "diagonal": "efm_diag",  # from here on: of the effective metric
    "shift": "efm_c",
    "actuation_shift": "efm_ca",
}
ROWS_DTYPE = np.dtype([(name, np.int64) for name in ("count", "contacts", *_POINTERS)])

# A ball pressed into a plane and a hinge beyond its range: contacts and limits at the first step.
# The hinge's servo is part of the effective metric.
_PROBE = """
<mujoco>
  <option integrator="discrete"/>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body pos="0 0 0.09"><freejoint/><geom size="0.1"/></body>
    <body pos="3 0 1">
      <joint name="hinge" axis="0 1 0" range="0.5 1" limited="true"/>
      <geom size="0.1" pos="0.3 0 0"/>
    </body>
  </worldbody>
  <actuator><position joint="hinge" kp="1"/></actuator>
</mujoco>
"""


@cache
def constraint_rows() -> tuple[int, ...]:
    """Return the offsets of the constraint rows in `mjData`: a record of `ROWS_DTYPE`.

    Raises:
        ImportError: the layout of `mjData` differs from MuJoCo's own description.
    """
    model = mujoco.MjModel.from_xml_string(_PROBE)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    described: Any = STRUCTS["mjData"].fields
    names = [field.name for field in described]
    # Pointers are stored one after the other, in the order of the description, after a known one.
    known = names.index("cfrc_ext")
    begin = (data.energy.ctypes.data - data._address) // 8  # before all pointers
    words = (ctypes.c_uint64 * (begin + known)).from_address(data._address)
    try:
        anchor = words[begin:].index(data.cfrc_ext.ctypes.data) + begin
    except ValueError:
        raise _unknown_layout() from None
    pointers = [8 * (anchor + names.index(name) - known) for name in _POINTERS.values()]
    # Size integers follow the timers: {double, int}, padded to 16 bytes, one each.
    first = data.warning.number.ctypes.data - data._address - 4
    timers = int(mujoco.mjtTimer.mjNTIMER)
    sizes = first + 8 * int(mujoco.mjtWarning.mjNWARNING)
    sizes += (-sizes) % 8 + 16 * timers
    count = sizes + 4 * (names.index("nefc") - names.index("ncon"))
    rows = dict(zip(ROWS_DTYPE.names or (), (count, sizes, *pointers), strict=True))
    _verify(rows, data)
    return tuple(rows.values())


def _verify(rows: dict[str, int], data: mujoco.MjData) -> None:
    ok = ctypes.c_int.from_address(data._address + rows["count"]).value == data.nefc > 0
    ok = ok and ctypes.c_int.from_address(data._address + rows["contacts"]).value == data.ncon
    for key, name in _POINTERS.items():
        if key == "contact":
            array = data.contact.dist
            offset = CONTACT_DTYPE.fields["dist"][1]  # pyright: ignore[reportOptionalSubscript]
        else:
            array, offset = getattr(data, name), 0
        if array.size == 0:
            continue
        pointer = ctypes.c_uint64.from_address(data._address + rows[key]).value
        ok = ok and pointer + offset == array.ctypes.data
    ok = ok and data.contact.mu[0] == _first(rows, data, "mu")
    ok = ok and data.contact.dim[0] == _first(rows, data, "dim")
    ok = ok and data.contact.efc_address[0] == _first(rows, data, "efc_address")
    if not ok:
        raise _unknown_layout()


def _unknown_layout() -> ImportError:
    return ImportError(
        f"mjData of MuJoCo {mujoco.mj_versionString()} is not laid out as MuJoCo describes it: the "
        "implicit scheme was tested with MuJoCo 3.17 and 4.0; scheme='explicit' works without"
    )


def _first(rows: dict[str, int], data: mujoco.MjData, name: str) -> Any:
    pointer = ctypes.c_uint64.from_address(data._address + rows["contact"]).value
    return np.frombuffer(ctypes.string_at(pointer, CONTACT_DTYPE.itemsize), CONTACT_DTYPE)[0][name]


CONTACT_DTYPE = record_of("mjContact")
