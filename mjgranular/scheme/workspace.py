"""Workspace of the implicit scheme in one simulation: its arrays, and MuJoCo's.

A kernel sees all of them as fields of one record, `w`: `w.nv`, `w.velocity[j]`, `w.cdof[j]`. Fields
of MuJoCo's structs keep MuJoCo's names. It is made once for each `MjData`: no step allocates.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import mujoco
import numpy as np

from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.engine import check_layout, is_sparse, offset_of, record_of
from mjgranular.kernel.memory import Views, ints, longs, views_at
from mjgranular.kernel.records import options_at
from mjgranular.law.kernel import LawKernel
from mjgranular.scheme.layout import HEAD_DTYPE, tile_size
from mjgranular.scheme.scheme import Workspace


@dataclass(frozen=True)
class Solver:
    """Counters of the implicit scheme since the sand met this `MjData`.

    Attributes:
        steps: number of steps in which an element was in the sand.
        evaluations: evaluations of all forces, summed over these steps.
        most: the largest number of evaluations in one step.
        unfinished: steps in which the law's forces leave more than a millionth of the momentum
            scale unbalanced; they use damping, which dissipates energy.
        residual: unbalanced momentum of the last step, in parts of the momentum scale; or inf.
        worst: largest residual of all steps.
    """

    steps: int
    evaluations: int
    most: int
    unfinished: int
    residual: float
    worst: float


EULER = int(mujoco.mjtIntegrator.mjINT_EULER)
IMPLICIT = int(mujoco.mjtIntegrator.mjINT_IMPLICIT)
DISCRETE = int(mujoco.mjtIntegrator.mjINT_DISCRETE)

POLY = int(mujoco.mjNPOLY)  # coefficients of damping beyond the linear one

_F, _I, _L = np.float64, np.int32, np.int64

_INTEGERS: tuple[str, ...] = (
    "nbody", "nv", "njnt", "nC", "nD",
    "nfriction",  # friction losses: of joints and tendons
    "nlone",  # degrees of freedom of lone free bodies
    "lanes", "tile_size", "tile_count",  # of tiles of elements
    "model", "data",  # addresses of `mjModel` and `mjData`
    "within",  # 1 if forces are computed inside `mj_step`, among the passive ones
    # This step's options (`read_options`): the integrator; whether it adds damping besides that in
    # the constraints; whether the constraints' Jacobian is sparse; whether their solver ends no
    # farther from the solution than it starts; whether MuJoCo factors the effective metric whenever
    # it computes it.
    "integrator", "damped", "sparse", "descends", "factored",
    "nefc", "ncon", "nJ",  # of this step's constraints (`open_constraints`)
    "count",  # of tiles filled in this step
    "evaluations",  # at most, of all forces in a step: `Implicit.evaluations`
)  # fmt: skip
_REALS: tuple[str, ...] = (
    "h",  # time step [s]
    "scale",  # size of the momentum, `balance.size_of`
)


def _by_name(groups: dict[Any, tuple[str, ...]]) -> dict[str, Any]:
    return {name: kind for kind, names in groups.items() for name in names}


_OF_MODEL = _by_name({
    (_I, ("nv",)): (
        "M_rownnz", "M_rowadr", "D_rownnz", "D_rowadr", "dof_bodyid", "dof_parentid", "dof_jntid",
    ),
    (_I, ("nC",)): ("M_colind",),
    (_I, ("nD",)): ("D_colind",),
    (_I, ("nbody",)): ("body_parentid", "body_dofadr", "body_dofnum", "body_weldid"),
    (_I, ("njnt",)): ("jnt_actuatorid",),  # that damps it: -1 for none, less for several
    (_F, ("nv",)): ("dof_damping",),
    (_F, ("nv", POLY)): ("dof_dampingpoly",),
})  # fmt: skip
_OF_DATA = _by_name({
    (_F, ("nv",)): (
        "qvel", "qfrc_smooth", "qfrc_constraint", "qfrc_bias",
        "qacc", "qacc_smooth", "qacc_warmstart", "qHDiagInv",
    ),
    (_F, ("nv", 6)): ("cdof", "cdof_dot"),
    (_F, ("nC",)): ("M", "qH"),
    (_F, ("nD",)): ("qDeriv",),
    (_F, ("nbody", 3)): ("subtree_com", "xipos"),
})  # fmt: skip
# In MuJoCo's arena, whose layout changes at every step: their pointers are read at every step.
_OF_CONSTRAINTS = {
    "contact": (record_of("mjContact"), ("ncon",)),
    **_by_name({
        (_I, ("nefc",)): ("efc_type", "efc_id", "efc_J_rownnz", "efc_J_rowadr"),
        (_I, ("nJ",)): ("efc_J_colind",),
        (_F, ("nJ",)): ("efc_J",),
        (_F, ("nefc",)): ("efc_frictionloss", "efc_D", "efc_aref"),
        # Absent without the effective metric; `efm_diag` and `efm_ca` may be absent with it.
        (_F, ("nv",)): ("efm_diag", "efm_c", "efm_ca"),
    }),
}  # fmt: skip
_OFFSETS = ("nefc", "ncon", *_OF_CONSTRAINTS)
_OWN = {
    "velocity": (_F, ("nv",)),  # v', unknown: at the end of the step
    "start": (_F, ("nv",)),  # v, at its beginning
    "smooth": (_F, ("nv",)),  # h q: momentum of all forces but those of sand and constraints
    "shift": (_F, ("nv",)),  # added by `discrete` to these forces for springs that move
    "sand": (_F, ("nv",)),  # h J^T f
    "constraint": (_F, ("nv",)),  # h q_c
    "residual": (_F, ("nv",)),  # R
    "change": (_F, ("nv",)),  # of the velocity, in a step of Newton's method
    "near": (_F, ("nv",)),  # velocity found by damping, or with a larger softness
    "found": (_F, ("nv",)),  # solution of the last linear balance, or of the softness before
    "gap": (_F, ("nv",)),  # distance from there to the velocity evaluated
    "rate": (_F, ("nv",)),  # (v' - v) / h
    "acceleration": (_F, ("nv",)),  # a = K (v' - v) / h, that of the constraints
    "trial": (_F, ("nv",)),  # temporaries: these four
    "product": (_F, ("nv",)),
    "solution": (_F, ("nv",)),
    "row": (_F, ("nv",)),
    "weight": (_F, ("nv",)),  # 1 / diagonal of A
    "inertia": (_F, ("nv", "nv")),  # A = M + C
    "damping": (_F, ("nv", "nv")),  # C, terms that the integrator adds to the inertia
    "jacobian": (_F, ("nv", "nv")),  # R', and its factors
    "undamped": (_F, ("nv", "nv")),  # K = 1 + M^-1 C; rows that constraints touch
    "touched": (_I, ("nv",)),  # 1 if a constraint touches the degree of freedom
    "springs": (_F, ("nv", "nv")),  # stiffness of constraints
    "motion": (_F, ("nbody", 6)),  # spatial velocities of bodies
    "before": (_F, ("nbody", 12)),  # at the start of the last step; spin, drift (`scheme.added`)
    # Twice the energy of a rigid body's sand at the start of the step: now, and before it turned.
    "energy": (_F, ("nbody", 2)),
    "wrench": (_F, ("nbody", 6)),  # about the center of the tree: moment, force
    "carried": (_F, ("nbody", 6)),  # the same plus those of the bodies that it carries
    "stiffness": (_F, ("nbody", 36)),  # K_b, minus the derivative of the wrench by the motion
    "immersed": (_I, ("nbody",)),  # 1 if a body or one that it carries has an element in the sand
    "friction": (_F, ("nfriction", 2)),  # of friction losses: acceleration and multiplier
    "dofs": (_I, ("nv",)),  # 0, 1, 2, ...
    "lone_dofs": (_I, ("nlone",)),
    "dof_spins": (_I, ("nv",)),  # 1 for those of `spins`
    "heads": (HEAD_DTYPE, ("tile_count",)),  # of tiles: body, live lanes
    "tiles": (_F, ("tile_count", "tile_size")),
    "statistics": ([(field.name, field.type) for field in fields(Solver)], (1,)),
    "offsets": (_L, (len(_OFFSETS),)),  # of what describes the constraints, in `mjData`
}
_VIEWS = Views(
    "Workspace",
    {**dict.fromkeys(_INTEGERS, _L), **dict.fromkeys(_REALS, _F)},
    {**_OF_MODEL, **_OF_DATA, **_OWN, **_OF_CONSTRAINTS},
)
_WORDS = _VIEWS.dtype.itemsize // 8
_FIRST_OF_CONSTRAINTS = _WORDS - len(_OF_CONSTRAINTS)
workspace_at = views_at(_VIEWS)
"""Kernel `workspace_at(address)`: the workspace whose record is at that address."""


def make_workspace(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    kernel: LawKernel,
    tiles: int,
    options: Mapping[str, int],
) -> Workspace:
    """Make the workspace of one simulation; see `Scheme.workspace` and `Implicit`."""
    lone = lone_free_dofs(model)
    record: Any = np.zeros(1, _VIEWS.dtype)
    numbers = {name: getattr(model, name) for name in ("nbody", "nv", "njnt", "nC", "nD")}
    numbers |= {
        "nfriction": model.nv + model.ntendon,
        "nlone": len(lone),
        "lanes": kernel.lanes,
        "tile_size": tile_size(kernel),
        "tile_count": tiles,
        "model": model._address,
        "data": data._address,
        **options,
    }
    own = {
        name: np.zeros([numbers.get(str(size), size) for size in shape], dtype)
        for name, (dtype, shape) in _OWN.items()
    }
    own["dofs"][:] = np.arange(model.nv)
    own["lone_dofs"][:] = lone
    own["dof_spins"][:] = spins(model)
    check_layout("mjData")
    own["offsets"][:] = [offset_of("mjData", name) for name in _OFFSETS]
    arrays = own | {name: getattr(model, name) for name in _OF_MODEL}
    arrays |= {name: getattr(data, name) for name in _OF_DATA}
    for name, number in numbers.items():
        record[name] = number
    for name, array in arrays.items():
        record[name] = array.ctypes.data
    return Workspace(record, own, own["statistics"])


def spins(model: mujoco.MjModel) -> np.ndarray:
    """Return which rotations are of a rigid tree that is free, or on slides, and so can drift."""
    found = np.zeros(model.nv, bool)
    roots = model.body_rootid[model.dof_bodyid]
    for body in np.unique(roots[roots == model.dof_bodyid]):
        dofs = np.flatnonzero(roots == body)
        joints = model.body_jntadr[body] + np.arange(model.body_jntnum[body])
        kinds, axes = model.jnt_type[joints], model.jnt_axis[joints]
        slides = np.cumprod(kinds == mujoco.mjtJoint.mjJNT_SLIDE).astype(bool)
        hinges = ~slides & (kinds == mujoco.mjtJoint.mjJNT_HINGE)
        ways = np.linalg.matrix_rank(axes[slides]) if slides.any() else 0
        planar = ways == 2 and np.abs(axes[hinges] @ axes[slides].T).max(initial=0.0) < 1e-9
        if len(dofs) != model.body_dofnum[body]:
            continue  # it has joints
        if (kinds == mujoco.mjtJoint.mjJNT_FREE).any():
            found[dofs[3:]] = True
        elif ways == 3 or (planar and (slides | hinges).all()):
            found[dofs[slides.sum() :]] = True
    return found


def lone_free_dofs(model: mujoco.MjModel) -> np.ndarray:
    """Return the degrees of freedom of all free bodies that carry no joint.

    For these `implicitfast` takes the gyroscopic moment implicitly too, without symmetry (measured
    with MuJoCo 3.17 and 4.0, including bodies with masses fixed to them).
    """
    root_dofs = np.bincount(model.body_rootid[model.dof_bodyid], minlength=model.nbody)
    free = model.jnt_type[model.dof_jntid] == mujoco.mjtJoint.mjJNT_FREE
    return np.flatnonzero(free & (root_dofs[model.body_rootid[model.dof_bodyid]] == 6))


_CG, _NEWTON = int(mujoco.mjtSolver.mjSOL_CG), int(mujoco.mjtSolver.mjSOL_NEWTON)
_NO_DAMPING = int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP | mujoco.mjtDisableBit.mjDSBL_DAMPER)
_NO_WARMSTART = int(mujoco.mjtDisableBit.mjDSBL_WARMSTART)
_EXACT_DIAGONAL = int(mujoco.mjtEnableBit.mjENBL_DIAGEXACT)


@compiled
def read_options(table, w):
    """Store the model's options for this step.

    MuJoCo's primal constraint solvers lower the cost at each of their steps, and the cost bounds
    the distance to the solution: they end no farther from it than they start.
    """
    options = options_at(table)
    w.sparse = is_sparse(w.model)
    primal = options.solver == _CG or options.solver == _NEWTON
    warm = options.disableflags & _NO_WARMSTART == 0
    w.descends = np.int64(primal and options.noslip_iterations == 0 and warm)
    w.integrator = options.integrator
    w.damped = w.integrator != DISCRETE
    if w.integrator == EULER:
        w.damped = options.disableflags & _NO_DAMPING == 0 and has_damping(w)
    w.factored = options.enableflags & _EXACT_DIAGONAL != 0


@compiled
def has_damping(w):
    """Return True if any joint is damped, by itself or by an actuator."""
    for j in range(w.nv):
        if w.dof_damping[j] > 0.0 or w.jnt_actuatorid[w.dof_jntid[j]] != -1:
            return True
        for k in range(POLY):
            if w.dof_dampingpoly[j, k] != 0.0:
                return True
    return False


@compiled
def open_constraints(address, w):
    """Read the addresses of MuJoCo's constraints and its effective metric in this step."""
    words, offsets = longs(address, _WORDS), w.offsets
    w.ncon = ints(w.data + offsets[1], 1)[0]
    w.nefc = ints(w.data + offsets[0], 1)[0]
    for k in range(2, len(offsets)):
        words[_FIRST_OF_CONSTRAINTS + k - 2] = longs(w.data + offsets[k], 1)[0]
    w.nJ = w.nefc * w.nv
    if w.sparse and w.nefc > 0:
        last = w.nefc - 1
        w.nJ = w.efc_J_rowadr[last] + w.efc_J_rownnz[last]
