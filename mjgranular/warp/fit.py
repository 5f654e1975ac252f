"""Check that a model fits MuJoCo Warp's step with sand, and list its bodies as integer tables."""

from typing import Any

import mujoco
import numpy as np

from mjgranular._util.checks import check_kind
from mjgranular.errors import InputError
from mjgranular.relief.relief import Relief, frame_of
from mjgranular.scheme.workspace import spins
from mjgranular.shape.select import last_dof
from mjgranular.surface import Bed, HeightField, Plane, Surface
from mjgranular.warp.motions import SLOT_DTYPE

_HAIR = 1e-5
"""Shift of inertial frames, relative to the body's size; chosen: MuJoCo takes 1e-6 m as zero."""

_SHAPES = ("geom_size", "geom_pos", "geom_quat")  # those of other geoms may differ between worlds
_SAME = ("nv", "nbody", "njnt", "ngeom", "geom_contype", "geom_conaffinity", *_SHAPES)


def slots_of(model: mujoco.MjModel, elements: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """List the bodies in the sand (`SLOT_DTYPE`) and the degrees of freedom that move each.

    These, which the records index, come body by body: those that turn its tree, then all from its
    last up to its root.
    """
    first = np.unique(elements["slot"], return_index=True)[1]
    slots = np.zeros(len(first), SLOT_DTYPE)
    slots["body"] = elements["body"][first]
    slots["root"] = model.body_rootid[slots["body"]]
    slots["first"], slots["end"] = first, [*first[1:], len(elements)]
    chains = [dofs_above(model, last_dof(model, int(body))) for body in slots["body"]]
    turning = spins(model)
    turns = [[dof for dof in chain if turning[dof]] for chain in chains]
    ends = np.cumsum([len(dofs) for both in zip(turns, chains, strict=True) for dofs in both])
    slots["spin"] = [0, *ends[1:-1:2]]
    slots["chain"], slots["chain_end"] = ends[::2], ends[1::2]
    dofs = [dof for both in zip(turns, chains, strict=True) for each in both for dof in each]
    return slots, np.array(dofs, np.int32)


def dofs_above(model: mujoco.MjModel, dof: int) -> list[int]:
    """List a degree of freedom and all above it in the tree, up to the root."""
    chain = []
    while dof >= 0:
        chain.append(dof)
        dof = int(model.dof_parentid[dof])
    return chain


def slots_of_dofs(nv: int, slots: np.ndarray, chain: np.ndarray) -> tuple[list[int], list[int]]:
    """List, for each degree of freedom, the bodies in the sand that it moves: rows of `slots`.

    Also return the first index of each, nv + 1 values.
    """
    moved: list[list[int]] = [[] for _ in range(nv)]
    for s, slot in enumerate(slots):
        for dof in chain[slot["chain"] : slot["chain_end"]]:
            moved[dof].append(s)
    first = np.cumsum([0, *(len(each) for each in moved)])
    return [s for each in moved for s in each], first.tolist()


def up_of(surface: Surface, model: mujoco.MjModel) -> np.ndarray:
    """Return the direction in which a surface is raised, a unit vector in the world frame."""
    base = surface.base if isinstance(surface, Relief) else surface
    if not isinstance(base, Plane | Bed | HeightField):
        return np.array([0.0, 0.0, 1.0])
    return frame_of(base, base.record(model)[0])["normal"]


def check_no_plugins(model: mujoco.MjModel) -> None:
    """Check that MuJoCo Warp accepts all plugins of a model."""
    for of in ("body", "actuator", "sensor"):
        if (getattr(model, f"{of}_plugin") >= 0).any():
            raise InputError(
                f"MuJoCo Warp takes no model with a plugin of a {of}, such as add_sand puts into "
                "one: give WarpSand and put_model the model without it"
            )


def check_model(model: mujoco.MjModel, chain: np.ndarray, geoms: list[int], m: Any) -> None:
    """Check that a MuJoCo Warp model belongs to this sand, made of `geoms`, and can hold it."""
    for name in _SAME:
        mine, given = getattr(model, name), getattr(m, name)
        given = given if name[0] == "n" else given.numpy()
        if name in _SHAPES:
            mine, given = mine[geoms], given[:, geoms]
        if not np.allclose(mine, given):
            raise InputError(
                f"attach: this sand was made for another model, {name} of which differs: make "
                "WarpSand first, and then put_model of the same model; what meets the sand has one "
                "shape in all worlds"
            )
    if m.opt.integrator != mujoco.mjtIntegrator.mjINT_DISCRETE:
        name = mujoco.mjtIntegrator(int(m.opt.integrator)).name.removeprefix("mjINT_").lower()
        raise InputError(
            f"the integrator {name} of MuJoCo Warp has no place for sand: set "
            "model.opt.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE before put_model"
        )
    flags, bit = int(m.opt.disableflags), mujoco.mjtDisableBit
    passive = bit.mjDSBL_SPRING | bit.mjDSBL_DAMPER
    bits = {"actuation": bit.mjDSBL_ACTUATION, "sensors": bit.mjDSBL_SENSOR}
    for what, flag in (bits | {"springs and dampers": passive}).items():
        if flags & flag == flag:
            raise InputError(f"with {what} disabled MuJoCo Warp omits sand: enable them first")
    for dof in sorted(set(chain.tolist())):
        if model.M_rownnz[dof] < len(dofs_above(model, dof)):
            body = model.body(int(model.dof_bodyid[dof])).name or "1"
            raise InputError(
                f"MuJoCo keeps the inertia of the body {body!r} as a diagonal, where sand that "
                "couples its degrees of freedom has no place: compile the model from "
                "mjgranular.warp.coupled(spec)"
            )


def coupled(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    """Copy a model so that sand can couple the degrees of freedom of single bodies.

    A body on its own in the world whose inertial frame is its body frame, such as a ball, has a
    diagonal inertia in MuJoCo. The copy has those frames moved by 1e-5 of the body's size.

    Raises:
        InputError: `spec` is not an `MjSpec`.
    """
    check_kind(spec, mujoco.MjSpec, "coupled")
    spec = spec.copy()
    model = spec.compile()
    for body in spec.bodies:
        if not model.body_simple[body.id] or not model.body_dofnum[body.id]:
            continue
        geoms = np.flatnonzero(model.geom_bodyid == body.id)
        size = max([1.0, *model.geom_rbound[geoms]])
        body.mass, body.inertia = model.body_mass[body.id], model.body_inertia[body.id]
        body.iquat = model.body_iquat[body.id]
        body.ipos = model.body_ipos[body.id] + [0.0, 0.0, _HAIR * size]
        body.explicitinertial = True
    return spec
