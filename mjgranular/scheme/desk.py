"""Where the implicit scheme works in one simulation: addresses, room for its numbers, counters."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.engine import ROWS_DTYPE, constraint_rows, is_sparse
from mjgranular.kernel.memory import floats, ints, longs, records
from mjgranular.kernel.options import options_at
from mjgranular.law.kernel import LawKernel
from mjgranular.scheme.layout import HEAD_DTYPE, tile_count, tile_size
from mjgranular.scheme.scheme import Desk

ACCOUNT_DTYPE = np.dtype(
    [
        ("steps", np.int64),  # with an element in the sand
        ("evaluations", np.int64),  # of forces and derivatives, in all of them
        ("most", np.int64),  # in one step
        ("softened", np.int64),  # steps that made do with a softer rest
        ("unfinished", np.int64),  # steps that left too much unbalanced
        ("residual", np.float64),  # of the last, in parts of the momentum that it moves; or inf
        ("worst", np.float64),  # of all
    ]
)
account_records = records(ACCOUNT_DTYPE)

# The desk's table: sizes and switches, then addresses, in the order of `make_desk`. WITHIN is 1
# where the sand is asked for its forces among MuJoCo's passive ones: what comes after them in the
# step is not there yet. INTEGRATOR, SPARSE and WARM follow from the model's options, and are read
# at each step (`read_options`); WARM where the engine's constraint solver ends no farther off than
# it begins. A block of elements (`scheme.layout`) has so many LANES and numbers; there is room for
# so many blocks, and for the holds of so many friction losses.
(
    NBODY, NV, MODEL, DATA, INTEGRATOR, SPARSE, LONE_COUNT, WITHIN, WARM, LANES, BLOCK_SIZE,
    BLOCK_COUNT, HOLD_COUNT,
) = range(13)  # fmt: skip
OF_MODEL = (
    "M_rownnz",
    "M_rowadr",
    "M_colind",
    "D_rownnz",
    "D_rowadr",
    "D_colind",
    "dof_bodyid",
    "dof_parentid",
    "body_parentid",
    "body_rootid",
    "body_dofadr",
    "body_dofnum",
    "dof_damping",
    "dof_dampingpoly",
    "dof_jntid",
    "jnt_actuatorid",
)
OF_DATA = (
    "qvel",
    "cdof",
    "M",
    "qDeriv",
    "qfrc_smooth",
    "qacc_smooth",
    "subtree_com",
    "xipos",
    "qfrc_constraint",
    "qacc_warmstart",
    "qacc",
    "qfrc_bias",
)
FIRST_OF_MODEL = 13
FIRST_OF_DATA = FIRST_OF_MODEL + len(OF_MODEL)
NUMBERS, HEADS, BLOCKS, ACCOUNT, ROWS, LONE = range(
    FIRST_OF_DATA + len(OF_DATA), FIRST_OF_DATA + len(OF_DATA) + 6
)
DESK_SIZE = LONE + 1
(
    M_SIZE, M_START, M_COLUMN, D_SIZE, D_START, D_COLUMN,
    DOF_BODY, DOF_PARENT, BODY_PARENT, BODY_ROOT, BODY_DOF, BODY_DOFS, DAMPING, DAMPING_POLY,
    DOF_JOINT, JOINT_ACTUATOR,
) = range(FIRST_OF_MODEL, FIRST_OF_DATA)  # fmt: skip
(
    QVEL, CDOF, INERTIA, DERIVATIVE, SMOOTH, ACCELERATION, TREE_COM, COM,
    CONSTRAINT, WARMSTART, QACC, BIAS,
) = range(FIRST_OF_DATA, NUMBERS)  # fmt: skip

# What moves a body's velocity at the end of a step besides its inertia and the forces at the start.
PLAIN, DAMPED, IMPLICIT_FAST, IMPLICIT_FULL = range(4)

POLY = int(mujoco.mjNPOLY)
"""Coefficients of damping beyond the linear one."""

_IMPLICIT = int(mujoco.mjtIntegrator.mjINT_IMPLICIT)
_IMPLICIT_FAST = int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
_CG, _NEWTON = int(mujoco.mjtSolver.mjSOL_CG), int(mujoco.mjtSolver.mjSOL_NEWTON)
_NO_DAMPING = int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP | mujoco.mjtDisableBit.mjDSBL_DAMPER)
_NO_WARMSTART = int(mujoco.mjtDisableBit.mjDSBL_WARMSTART)

Room = namedtuple(
    "Room",
    [
        "velocity",  # sought, at the end of the step
        "start",  # at the beginning
        "trial",
        "change",
        "smooth",  # momentum of all forces but sand and constraints
        "residual",
        "sand",  # momentum of the sand
        "bound",  # momentum of the constraints
        "rate",  # of the velocity over the step
        "acceleration",
        "row",  # of a constraint, or of several of them together
        "firm",  # what the row makes of a change of velocity
        "answer",
        "product",
        "weight",  # 1 / the diagonal of what resists
        "inertia",  # what resists a change of velocity over the step, nv x nv
        "extra",  # of it, what is not inertia
        "matrix",  # derivative of the residual
        "motion",  # spatial velocities of bodies
        "own",  # wrenches on bodies about the centre of their tree: moment, force
        "total",  # the same with those of the bodies that they carry
        "stiffness",  # derivative of the wrench, 6 x 6 each
        "wet",  # whether a body or one that it carries has an element in the sand
        "rows",  # rows of the constraints, nv numbers each, of the first ROWS_KEPT
        "firms",  # the same as `firm`
        "holds",  # of friction losses: acceleration last looked at, and the grip there
    ],
)


ROWS_KEPT = 64
"""Constraint rows that are prepared once a step; more are worked out whenever they are read."""


def room_size(nv: int, nbody: int, ntendon: int) -> int:
    """How many numbers `open_room` divides."""
    of_bodies = (6 + 6 + 6 + 36 + 1) * nbody
    return (15 + 2 * ROWS_KEPT) * nv + 3 * nv * nv + of_bodies + 2 * (nv + ntendon)


@compiled
def open_room(desk):
    """Addresses of the arrays that the solver works on; each function opens what it needs.

    As arrays they would be passed in seven words each, and take numba twice as long to compile.
    """
    nv, nbody = desk[NV], desk[NBODY]
    v, m = 8 * nv, 8 * nv * nv
    a = desk[NUMBERS]
    b = a + 15 * v
    c = b + 3 * m
    w = 48 * nbody  # of six numbers a body
    e = c + 9 * w + 8 * nbody
    return Room(
        a, a + v, a + 2 * v, a + 3 * v, a + 4 * v, a + 5 * v, a + 6 * v, a + 7 * v, a + 8 * v,
        a + 9 * v, a + 10 * v, a + 11 * v, a + 12 * v, a + 13 * v, a + 14 * v,
        b, b + m, b + 2 * m,
        c, c + w, c + 2 * w, c + 3 * w, c + 9 * w,
        e, e + ROWS_KEPT * v, e + 2 * ROWS_KEPT * v,
    )  # fmt: skip


@compiled
def desk_at(address):
    """The desk's table at an address."""
    return longs(address, DESK_SIZE)


@compiled
def vectors_at(desk, number, row):
    """Three rows of a block: the vectors of its elements, components `LANES` apart."""
    lanes = desk[LANES]
    return floats(desk[BLOCKS] + 8 * (desk[BLOCK_SIZE] * number + row * lanes), 3 * lanes)


def make_desk(
    model: mujoco.MjModel,
    elements: np.ndarray,
    kernel: LawKernel,
    *,
    within: bool,
    model_address: int,
    data_address: int,
    of_model: Callable[[str], int],
    of_data: Callable[[str], int],
) -> Desk:
    """Lays out the desk for one simulation.

    Args:
        model: the model.
        elements: of the law.
        kernel: of the law.
        within: whether forces are asked for among MuJoCo's passive ones, inside its step.
        model_address: of `mjModel`.
        data_address: of `mjData`.
        of_model: address of an array of the model by its name.
        of_data: address of an array of the data by its name.
    """
    count = tile_count(kernel, elements)
    heads = np.zeros(count, HEAD_DTYPE)
    blocks = np.zeros(count * tile_size(kernel))
    numbers = np.zeros(room_size(model.nv, model.nbody, model.ntendon))
    account = np.zeros(1, ACCOUNT_DTYPE)
    rows = np.array([constraint_rows()], ROWS_DTYPE)
    lone = lone_free_joints(model)
    sizes = (
        model.nbody,
        model.nv,
        model_address,
        data_address,
        0,  # INTEGRATOR, SPARSE
        0,
        len(lone),
        int(within),
        0,  # WARM
        kernel.lanes,
        tile_size(kernel),
        count,
        model.nv + model.ntendon,
    )
    holds: tuple[Any, ...] = (numbers, heads, blocks, account, rows, lone)
    addresses = (
        *(of_model(name) for name in OF_MODEL),
        *(of_data(name) for name in OF_DATA),
        *(array.ctypes.data for array in holds),
    )
    return Desk(np.array([*sizes, *addresses], np.int64), holds, account)


@compiled
def read_options(table, desk):
    """Notes what the model's options are in this step.

    Args:
        table: the simulation's (`kernel.memory`).
        desk: the solver's.
    """
    options = options_at(table)
    desk[INTEGRATOR] = integrator_of(desk, options)
    desk[SPARSE] = is_sparse(desk[MODEL])
    desk[WARM] = descends(options)


@compiled
def integrator_of(desk, options):
    """How the integrator turns forces into velocities, one of the four above."""
    if options.integrator == _IMPLICIT:
        return IMPLICIT_FULL
    if options.integrator == _IMPLICIT_FAST:
        return IMPLICIT_FAST
    if options.disableflags & _NO_DAMPING != 0:
        return PLAIN
    nv = desk[NV]
    damping, poly = floats(desk[DAMPING], nv), floats(desk[DAMPING_POLY], POLY * nv)
    joints = ints(desk[DOF_JOINT], nv)
    for j in range(nv):
        if damping[j] > 0.0 or joint_actuator(desk, joints[j]) != -1:
            return DAMPED
    for k in range(POLY * nv):
        if poly[k] != 0.0:
            return DAMPED
    return PLAIN


@compiled
def joint_actuator(desk, joint):
    """The actuator that damps a joint, -1 for none, less for several."""
    return ints(desk[JOINT_ACTUATOR], joint + 1)[joint]


@compiled
def descends(options):
    """Whether the engine's constraint solver begins where it is told and only gets closer.

    Its primal solvers lower the cost at each step, and the cost bounds the distance.
    """
    primal = options.solver == _CG or options.solver == _NEWTON
    warm = options.disableflags & _NO_WARMSTART == 0
    return np.int64(primal and options.noslip_iterations == 0 and warm)


def lone_free_joints(model: mujoco.MjModel) -> np.ndarray:
    """First degree of freedom of each free body that carries no joint, int32.

    For these `implicitfast` takes the gyroscopic moment implicitly too, without symmetry (measured
    with MuJoCo 3.17 and 4.0, masses that are fixed to the body included).
    """
    root_dofs = np.bincount(model.body_rootid[model.dof_bodyid], minlength=model.nbody)
    lone = [
        int(model.jnt_dofadr[joint])
        for joint in range(model.njnt)
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE
        and root_dofs[model.body_rootid[model.jnt_bodyid[joint]]] == 6
    ]
    return np.array(lone, np.int32)
