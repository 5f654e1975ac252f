"""The rules for `respond` that a custom law may break; docs/architecture.md has them in words."""

from functools import cache
from itertools import product
from typing import Any

import mujoco
import numpy as np

from mjgranular.errors import InputError
from mjgranular.kernel.compiled import compiled, entry
from mjgranular.kernel.fields import column, packed, size_of
from mjgranular.kernel.memory import floats, records
from mjgranular.kernel.motion import still
from mjgranular.kernel.vector import diagonal, dot, norm, read_vector
from mjgranular.law.kernel import LawKernel, Pose
from mjgranular.law.law import Law

_DIRECTION = np.array([0.6, 0.48, 0.64])
_TOLERANCE = 1e-3  # chosen: derivatives may be differences


@cache
def _rules_kernel(kernel: LawKernel, scene_dtype: np.dtype) -> Any:
    """Make a kernel `add_power(scene, elements, count, account)`, of addresses.

    The account is the position of the body, its velocity, the number of elements in the sand, a
    relative error of F = F'(p) p, and the power of static resistance and of drag.
    """
    scenes, size = records(scene_dtype), size_of(kernel.element)
    read, own = column(kernel.element, 1).read, kernel.multiplier.own
    sample, respond = kernel.sample, kernel.respond

    @compiled
    def add_power(scene, elements, count, account):
        record, out = scenes(scene, 1)[0], floats(account, 10)
        law, place = record.law, record.surface
        at, v = read_vector(out, 0), read_vector(out, 3)
        pose = Pose(at, diagonal(1.0), at, at, still())
        for i in range(count):
            element = read(floats(elements + 8 * size * i, size), 0)
            found = sample(element, pose, law, place, 9.81)
            if found.depth > 0.0:
                static, _, drag, _ = respond(found, law, 9.81, v, own(found, v, 1e-150), 0.0)
                p = own(found, v, norm(v))
                soft, by_p, _, _ = respond(found, law, 9.81, v, p, norm(v))
                error = norm(by_p @ p - soft)
                out[6] += 1.0
                if not error <= _TOLERANCE * norm(soft):  # NaN is an error too
                    out[7] = error / norm(soft)
                out[8] += dot(static, v)
                out[9] += dot(drag, v)

    return add_power


def check_rules(
    law: Law, kernel: LawKernel, elements: np.ndarray, scene: np.ndarray, model: mujoco.MjModel
) -> None:
    """Check the forces of a custom law on its elements, moved to a place in the sand."""
    if type(law).__module__.startswith("mjgranular."):
        return  # has been tested; to load the kernel takes time
    numbers, account = packed(elements, kernel.element), np.zeros(10)
    add_power = entry(_rules_kernel(kernel, scene.dtype), "void(int64, int64, int64, int64)")
    addresses = scene.ctypes.data, numbers.ctypes.data, len(numbers), account.ctypes.data
    for distance in (0.1, 1, 10, 100):
        for *corner, side in product(*3 * [(-1, 0, 1)], (-1, 1)):
            account[:3] = model.stat.center + distance * model.stat.extent * np.array(corner)
            account[3:6] = side * _DIRECTION
            add_power(*addresses)
        if account[6] > 0:
            break
    error, static, drag = account[7:]
    respond = f"{type(law).__name__}: respond must return"
    if not np.isfinite(static + drag):
        raise InputError(f"{respond} finite forces, got {static + drag} N")
    for force, power in (("a static resistance", static), ("a drag", drag)):
        if power > 1e-9:  # [W], at 1 m/s; rounding
            raise InputError(f"{respond} {force} that opposes the motion, got the reverse")
    if error != 0:
        raise InputError(
            f"{respond} a derivative by p that, times p, is the static resistance, got a relative "
            f"error of {error:.2g}"
        )
