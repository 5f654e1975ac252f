"""MuJoCo's library: functions that kernels call during a step, and its structs in memory.

Structs are read by MuJoCo's own description of them (`mujoco.introspect`): no compiler is
available here to read its headers, which differ between versions. A description is trusted once it
agrees with what Python shows of the same memory (`check_layout`).
"""

import ctypes
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, Self

import mujoco
import numpy as np
from mujoco.introspect.ast_nodes import ArrayType, PointerType
from mujoco.introspect.structs import STRUCTS

from mjgranular.errors import GranularError
from mjgranular.kernel.intrinsics import c_function, publish_functions

_PATTERN = {"win32": "mujoco.dll", "darwin": "libmujoco*.dylib"}.get(sys.platform, "libmujoco.so*")

_POINTER, _TEXT = ctypes.c_void_p, ctypes.c_char_p
# Functions that Python calls with addresses, without MuJoCo's Python bindings.
_FUNCTIONS = {
    "mjp_defaultPlugin": (None, _POINTER),
    "mjp_registerPlugin": (ctypes.c_int, _POINTER),
    "mjp_getPlugin": (_POINTER, _TEXT, _POINTER),
    "mj_getPluginConfig": (_TEXT, _POINTER, ctypes.c_int, _TEXT),
    "mj_id2name": (_TEXT, _POINTER, ctypes.c_int, ctypes.c_int),
    "mj_copyModel": (_POINTER, _POINTER, _POINTER),
    "mju_malloc": (_POINTER, ctypes.c_size_t),
}


@cache
def library() -> ctypes.CDLL:
    """Return the library that `import mujoco` has loaded, with the types of the functions above."""
    folder = Path(str(mujoco.__file__)).parent
    found = sorted(folder.glob(_PATTERN))
    if not found:
        raise ImportError(f"MuJoCo's library {_PATTERN} is not in {folder}")
    loaded = ctypes.CDLL(str(found[0]))
    for name, (result, *arguments) in _FUNCTIONS.items():
        function = getattr(loaded, name)
        function.restype, function.argtypes = result, arguments
    return loaded


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
is_inside_site = _function("mj_insideSite", _ADDRESS, _ADDRESS, _INT, _ADDRESS, result=_INT)
get_state = _function("mj_getState", _ADDRESS, _ADDRESS, _ADDRESS, _INT)
solve_inertia = _function("mj_solveM", _ADDRESS, _ADDRESS, _ADDRESS, _ADDRESS, _INT)
smooth_derivative = _function("mjd_smooth_vel", _ADDRESS, _ADDRESS, _INT)
is_sparse = _function("mj_isSparse", _ADDRESS, result=_INT)
actuator_damping = _function("mj_actuatorDamping", _ADDRESS, _INT, _INT, _ADDRESS, result="float64")
init_geom = _function("mjv_initGeom", _ADDRESS, _INT, *4 * (_ADDRESS,))
connect_geom = _function("mjv_connector", _ADDRESS, _INT, "float64", _ADDRESS, _ADDRESS)
# For the integrator `discrete`: metric and constraint rows without calling the user's controller.
inverse_dynamics = _function("mj_inverseSkip", _ADDRESS, _ADDRESS, _INT, _INT)
metric_shift = _function("mj_effShift", _ADDRESS, _ADDRESS)
add_metric_product = _function("mj_effMulAdd", _ADDRESS, _ADDRESS, _ADDRESS, _ADDRESS, _INT)
factor_inertia = _function("mj_factorI", *2 * (_ADDRESS,), _INT, *4 * (_ADDRESS,))
turns_freely = _function("mjd_freeGyroPossible", _ADDRESS, _ADDRESS, _INT, result=_INT)
free_bias_derivative = _function("mjd_freeBias_vel", _ADDRESS, _ADDRESS, _INT, _ADDRESS)


TESTED = ("3.17.0", "4.0.0")  # versions of MuJoCo that the tests were run with

_KINDS = {
    "mjtNum": np.float64,
    "double": np.float64,
    "float": np.float32,
    "int": np.int32,
    "unsigned int": np.uint32,
    "mjtSize": np.int64,
    "size_t": np.uint64,
    "uint64_t": np.uint64,
    "uintptr_t": np.uint64,
    "mjtByte": np.uint8,
    "mjtBool": np.uint8,
    "char": np.int8,
}

# A ball pressed into a plane and a hinge beyond its range: contacts and limits at the first step.
# The hinge's servo is part of the effective metric.
_PROBE = """
<mujoco>
  <option integrator="discrete"/>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body pos="0 0 0.09"><freejoint/><geom size="0.1"/><site/></body>
    <body pos="3 0 1">
      <joint name="hinge" axis="0 1 0" range="0.5 1" limited="true"/>
      <geom size="0.1" pos="0.3 0 0"/>
    </body>
  </worldbody>
  <actuator><position joint="hinge" kp="1"/></actuator>
  <sensor><clock/></sensor>
</mujoco>
"""


class LayoutError(GranularError, RuntimeError):
    """A struct of this version of MuJoCo is not laid out as MuJoCo describes it."""

    @classmethod
    def of(cls, what: str) -> Self:
        """Return the error for a struct."""
        return cls(
            f"{what} of MuJoCo {mujoco.__version__} is not laid out as described; tested versions "
            f"of MuJoCo: {', '.join(TESTED)}. Sand(model, scheme='explicit').step(data) reads the "
            "least of MuJoCo's memory"
        )


@cache
def fields_of(struct: str) -> dict[str, Any]:
    """Return MuJoCo's description of the fields of a struct, by name."""
    described: Any = STRUCTS[struct].fields
    return {field.name: field for field in described}


@cache
def record_of(struct: str) -> np.dtype:
    """Return the record of a struct, with the layout of C; a pointer is an integer."""
    return _record(fields_of(struct).values())


def offset_of(struct: str, field: str) -> int:
    """Return the offset of a field in a struct [bytes]."""
    fields: Any = record_of(struct).fields
    return int(fields[field][1])


def read_struct(struct: str, address: int) -> np.ndarray:
    """Return a copy of the struct at an address, shape (1,)."""
    record = record_of(struct)
    return np.frombuffer(ctypes.string_at(address, record.itemsize), record)


def array_size(struct: str, name: str, head: bytes) -> int:
    """Return the size of the array that a field of a struct points to [bytes].

    The head of a struct is its content as far as it has the sizes of arrays.
    """
    field, fields = fields_of(struct)[name], record_of(struct).fields or {}
    size = _dtype(field.type.inner_type).itemsize
    for extent in field.array_extent:
        if extent in fields:
            dtype, offset, *_ = fields[extent]
            size *= int(np.frombuffer(head, dtype, 1, offset)[0])
        else:  # a number, or the name of a constant
            size *= extent if isinstance(extent, int) else int(getattr(mujoco, extent))
    return size


@cache
def check_layout(struct: str) -> None:
    """Compare the description of a struct with what Python shows of one."""
    try:
        if not all(_agrees(*example) for example in _examples(struct)):
            raise LayoutError.of(struct)
    except (GranularError, MemoryError, OSError):
        raise
    except Exception as error:
        raise LayoutError.of(f"{struct} ({error!r})") from error


def _record(fields: Any) -> np.dtype:
    return np.dtype([(field.name, _dtype(field.type)) for field in fields], align=True)


def _dtype(kind: Any) -> np.dtype:
    if isinstance(kind, PointerType):
        return np.dtype(np.int64)
    if isinstance(kind, ArrayType):
        return np.dtype((_dtype(kind.inner_type), kind.extents))
    if hasattr(kind, "fields"):  # a struct without a name
        return _record(kind.fields)
    return record_of(kind.name) if kind.name in STRUCTS else np.dtype(_KINDS[kind.name])


def _agrees(struct: str, address: int, shown: Any) -> bool:
    """Return True if the struct at an address is what Python shows as the attributes of `shown`."""
    record = read_struct(struct, address)[0]
    return all(
        _is_shown(record[name], getattr(shown, name, None), isinstance(field.type, PointerType))
        for name, field in fields_of(struct).items()
    )


def _is_shown(value: Any, shown: Any, is_pointer: bool) -> bool:
    if is_pointer:
        if isinstance(shown, bytes):
            return ctypes.string_at(int(value), len(shown)) == shown
        array = isinstance(shown, np.ndarray) and shown.size > 0
        return not array or value in (0, shown.ctypes.data)  # 0: not computed for this model
    if isinstance(shown, (int, float, np.ndarray)):
        return np.array_equal(np.ravel(value), np.ravel(shown), equal_nan=True)
    return True  # a struct


def _examples(struct: str) -> Iterator[tuple[str, int, Any]]:
    """Yield structs, their addresses, and what Python shows of them."""
    if struct == "mjOption":  # a different number in each
        options = mujoco.MjModel.from_xml_string("<mujoco/>").opt
        for number, name in enumerate(fields_of("mjOption"), start=2):
            if isinstance(getattr(options, name), np.ndarray):
                getattr(options, name)[:] = number
            else:
                setattr(options, name, number)
        yield struct, options.gravity.ctypes.data - offset_of(struct, "gravity"), options
        return
    model = mujoco.MjModel.from_xml_string(_PROBE)
    if struct == "mjModel":
        yield struct, model._address, model
        yield "mjOption", model._address + offset_of(struct, "opt"), model.opt
    elif struct == "mjData":
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        yield struct, data._address, data
        contacts = int(read_struct(struct, data._address)["contact"][0])
        yield "mjContact", contacts, data.contact[0]
    else:
        scene = mujoco.MjvScene(model, 2)
        scene.geoms[1].pos[:] = 1, 2, 3
        first = scene.geoms[0].pos.ctypes.data - offset_of(struct, "pos")
        for index in range(2):
            scene.geoms[index].label = ""  # new memory may not be text
            yield struct, first + index * record_of(struct).itemsize, scene.geoms[index]
