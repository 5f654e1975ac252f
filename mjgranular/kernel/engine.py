"""MuJoCo's library: functions that kernels call during a step."""

import ctypes
import sys
from functools import cache
from pathlib import Path
from typing import Any

import mujoco

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
