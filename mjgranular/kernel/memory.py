"""One table of integers through which kernels read and write a simulation.

Handing numba a NumPy array costs about 80 ns each, and a kernel needs a dozen arrays of `mjData`
and four of ours: more than the time of a bare `mj_step` on a one-link model. Their addresses do not
change while the `MjData` lives, so one table of addresses stands for them all. An engine plugin,
which gets no NumPy arrays but only the `mjData*`, fills the same table.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numba import (
    carray,  # pyright: ignore[reportPrivateImportUsage]
    from_dtype,
    types,
)
from numba.extending import intrinsic

from mjgranular.kernel.compiled import compiled

# The table: four sizes, then addresses. The order is that of `simulation_table`. Within `mj_step`
# (`engine.block`) XFRC, WARNINGS and KEEP are 0: there they are MuJoCo's own business.
NBODY, NV, ELEMENT_COUNT, BODY_COUNT = range(4)
GRAVITY, DOF_PARENT, XPOS, XMAT, XIPOS, SUBTREE_COM, CVEL, CDOF, WARMSTART, XFRC = range(4, 14)
WARNINGS, ELEMENTS, BODIES, SCENE, CONTACTS, KEEP, DESK = range(14, 21)
TABLE_SIZE = 21


def simulation_table(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    *,
    elements: np.ndarray,
    bodies: np.ndarray,
    scene: np.ndarray,
    contacts: np.ndarray,
    spans: np.ndarray,
    desk: np.ndarray,
) -> np.ndarray:
    """Makes the table of sizes and addresses.

    Args:
        model: the model.
        data: its data.
        elements: the law's elements, shape (n,).
        bodies: rows of `sand.binding.BODY_DTYPE`, shape (m,).
        scene: parameters of law, medium and surface, shape (1,).
        contacts: rows of `sand.binding.CONTACT_DTYPE`, shape (n,).
        spans: what is kept of the state (`kernel.keep`).
        desk: what the scheme works with (`Scheme.desk`).

    Returns:
        The table, shape (21,), int64. It keeps nothing alive: all of the arguments must outlive
        every use of it.
    """
    arrays = (
        model.opt.gravity,
        model.dof_parentid,
        data.xpos,
        data.xmat,
        data.xipos,
        data.subtree_com,
        data.cvel,
        data.cdof,
        data.qacc_warmstart,
        data.xfrc_applied,
        data.warning.number,
        elements,
        bodies,
        scene,
        contacts,
        spans,
        desk,
    )
    sizes = (model.nbody, model.nv, len(elements), len(bodies))
    return np.array([*sizes, *(array.ctypes.data for array in arrays)], dtype=np.int64)


def records(dtype: np.dtype) -> Any:
    """Makes a kernel `read(address, size)` that gives the array of such records at an address."""
    record = from_dtype(dtype)

    def cast(typingctx: Any, address: Any) -> Any:
        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            return builder.inttoptr(args[0], context.get_value_type(signature.return_type))

        return types.CPointer(record)(types.int64), codegen

    pointer: Any = intrinsic(cast)

    @compiled
    def read(address, size):
        return carray(pointer(address), (size,))

    return read


floats = records(np.dtype(np.float64))
ints = records(np.dtype(np.int32))
longs = records(np.dtype(np.int64))


@compiled
def row_of(address, number, width):
    """A row of a matrix of floats at an address.

    Numba asks of each index whether it is negative, and counts from the end then; not of constants,
    which indices into a row are.
    """
    return floats(address + 8 * width * number, width)


@compiled
def table_at(address):
    """The table at an address."""
    return longs(address, TABLE_SIZE)
