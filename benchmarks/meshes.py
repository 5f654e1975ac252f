"""A robot of meshes: what sand costs it, and how far its patches are from its triangles.

    python benchmarks/meshes.py scene.xml --instead-of floor

Costs are those of a step from the start, in its fall and where it lies, beside a step of the same
robot on its own floor; processor time, so that others on the machine matter less. Errors are those
of the sand's whole force and moment in drawn poses, a tenth to half of the robot's height deep,
with all joints turning, to those with facets many times finer; a moment's in parts of the sum of
all bodies' moments. The law on the meshes' own triangles is compared as well: large ones are in the
sand, and lead, as wholes, which is an error of its own.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import mujoco
import numpy as np
import tyro

from mjgranular import Explicit, Sand
from mjgranular.errors import GranularWarning
from mjgranular.law import Rft3dLaw
from mjgranular.shape import facets_from_model

_MOMENTS = {"start": 50, "fall": 350, "rest": 2000}  # steps before each moment
_STEPS, _TURNS = 40, 25


class OnTriangles(Rft3dLaw):
    """The law on the triangles of a mesh."""

    def elements(
        self, model: mujoco.MjModel, geoms: Sequence[int], resolution: int | None = None
    ) -> np.ndarray:
        return facets_from_model(model, geoms, resolution, meshes="triangles")


@dataclass(frozen=True)
class Options:
    """Cost and error of a robot of meshes on sand."""

    model: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL.xml")]
    """The robot, with a floor; its first joint is free."""
    instead_of: Annotated[tuple[str, ...], tyro.conf.arg(metavar="GEOM ...")] = ("floor",)
    """Geoms that the sand replaces."""
    resolutions: Annotated[tuple[int, ...], tyro.conf.arg(metavar="N ...")] = (6, 12, 24)
    """What is tried beside the default."""
    fine: Annotated[int, tyro.conf.arg(metavar="N")] = 64
    """What is taken for exact."""
    states: Annotated[int, tyro.conf.arg(metavar="N")] = 100
    """Poses that are drawn."""


def _cost(step: Callable[[], object]) -> float:
    """Return the time of one step [us]."""
    begin = time.thread_time()
    for _ in range(_STEPS):
        step()
    return (time.thread_time() - begin) / _STEPS * 1e6


def ratios(options: Options, **sand_options: Any) -> dict[str, tuple[float, float]]:
    """Return the cost of a step on sand [us], and the ratio to one on the floor, at each moment."""
    model = mujoco.MjModel.from_xml_path(str(options.model))
    floor = mujoco.MjModel.from_xml_path(str(options.model))
    sand = Sand(model, instead_of=options.instead_of, **sand_options)
    found = {}
    for moment, steps in _MOMENTS.items():
        data, bare = mujoco.MjData(model), mujoco.MjData(floor)
        mujoco.mj_step(floor, bare, steps)
        for _ in range(steps):
            sand.step(data)
        pairs = [
            (_cost(lambda d=data: sand.step(d)), _cost(lambda d=bare: mujoco.mj_step(floor, d)))
            for _ in range(_TURNS)
        ]
        cost = float(np.median([on_sand for on_sand, _ in pairs]))
        found[moment] = cost, float(np.median([a / b for a, b in pairs]))
    return found


def _states(model: mujoco.MjModel, geoms: np.ndarray, count: int) -> list[tuple[Any, Any]]:
    rng, data = np.random.default_rng(0), mujoco.MjData(model)
    limited = model.jnt_limited[1:].astype(bool)
    states = []
    while len(states) < count:
        qpos, qvel = model.qpos0.copy(), rng.normal(size=model.nv) * 0.5
        joints = qpos[7:] + 0.3 * rng.normal(size=model.nq - 7)
        low, high = model.jnt_range[1:].T
        qpos[7:] = np.where(limited, np.clip(joints, low, high), joints)
        upright = np.array([1.0, 0, 0, 0]) + 0.1 * rng.normal(size=4)
        turn = upright if len(states) % 2 == 0 else rng.normal(size=4)
        qpos[:3], qpos[3:7] = 0.0, turn / np.linalg.norm(turn)
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        axes = data.geom_xmat[geoms].reshape(-1, 3, 3)
        middle = data.geom_xpos[geoms] + np.einsum("nij,nj->ni", axes, model.geom_aabb[geoms, :3])
        reach = np.einsum("nj,nj->n", np.abs(axes[:, 2]), model.geom_aabb[geoms, 3:])
        bottom, top = (middle[:, 2] - reach).min(), (middle[:, 2] + reach).max()
        qpos[2] = -bottom - rng.uniform(0.1, 0.5) * (top - bottom)
        states.append((qpos, qvel))
    return states


def _loads(sand: Sand, states: Sequence[tuple[Any, Any]]) -> tuple[np.ndarray, ...]:
    """Return total force, moment about the robot's center, sum of body moments; by state."""
    model, data = sand.model, mujoco.MjData(sand.model)
    forces, moments, sizes = [], [], []
    for qpos, qvel in states:
        data.qpos[:], data.qvel[:] = qpos, qvel
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        data.xfrc_applied[:] = 0
        sand.apply(data)
        force, moment = data.xfrc_applied[:, :3], data.xfrc_applied[:, 3:]
        moment = moment + np.cross(data.xipos - data.subtree_com[1], force)
        forces.append(force.sum(axis=0))
        moments.append(moment.sum(axis=0))
        sizes.append(np.linalg.norm(moment, axis=1).sum())
    return np.array(forces), np.array(moments), np.array(sizes)


def main(options: Options) -> None:
    """Print a table."""
    warnings.simplefilter("ignore", GranularWarning)
    model = mujoco.MjModel.from_xml_path(str(options.model))
    exact = Sand(
        model,
        law="rft3d",
        instead_of=options.instead_of,
        resolution=options.fine,
        scheme=Explicit(half_step=False),
    )
    states = _states(model, np.unique(exact.elements["geom"]), options.states)
    force, moment, sizes = _loads(exact, states)
    law = exact.law
    assert isinstance(law, Rft3dLaw)
    cases: dict[str, dict[str, Any]] = {"default": {"law": law}}
    cases |= {f"resolution {n}": {"law": law, "resolution": n} for n in options.resolutions}
    cases["triangles"] = {"law": OnTriangles(**vars(law))}
    print("| | facets | " + " | ".join(f"{moment}: us, ratio" for moment in _MOMENTS), end=" | ")
    print("force: median, 95 % [%] | moment: median, 95 % [%] |")
    for name, given in cases.items():
        sand = Sand(model, instead_of=options.instead_of, scheme=Explicit(half_step=False), **given)
        mine, turned, _ = _loads(sand, states)
        off = 100 * np.linalg.norm(mine - force, axis=1) / np.linalg.norm(force, axis=1)
        twist = 100 * np.linalg.norm(turned - moment, axis=1) / sizes
        costs = ratios(options, **given)
        row = [name, f"{len(sand.elements):,}"]
        row += [f"{cost:.0f}, {ratio:.1f}" for cost, ratio in costs.values()]
        row += [f"{np.median(x):.1f}, {np.quantile(x, 0.95):.1f}" for x in (off, twist)]
        print(f"| {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
