"""Metamorphic tests: a drawn model and its twin, from one MjSpec, must move alike.

If only the description differs (order of geoms, welded pieces, position and orientation of the
world, its mirror image), motions are equal up to rounding; with other facets or other time steps,
nearly so. `Question` also scales all lengths, times and masses, for tests of Froude similarity.
"""

from __future__ import annotations

import math
import warnings
from argparse import Namespace
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any, NamedTuple

import mujoco
import numpy as np
from attacks import models, motions
from attacks.cases import ModelCase, Result, arguments

from mjgranular import Plane, Sand

STEPS, TIMESTEP = 16, 1e-3
EXACT, CUT, HALF = 1e-6, 0.05, 0.05  # in parts of the largest speed; the last two chosen
FINE, FINER = 12, 48  # resolution for other facets, and with memory: halves of the least cell
_FREE, _HINGE = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_HINGE)


class Question(NamedTuple):
    """A change of a twin, and the expected motion.

    Attributes:
        name: name of the question.
        change: changes the spec in place.
        sand: arguments of `Sand` that differ.
        turn: matrix that rotates or mirrors positions.
        scale: factor of lengths.
        refine: divisor of the time step.
        nudge: initial difference of velocities.
        halves: whether two sands of half the strength act in place of one.
        tolerance: tolerance in parts of the largest speed.
    """

    name: str
    change: Callable[[mujoco.MjSpec], object] = lambda _spec: None
    sand: Mapping[str, Any] = MappingProxyType({})
    turn: np.ndarray = np.eye(3)
    scale: float = 1.0
    refine: int = 1
    nudge: float = 0.0
    halves: bool = False
    tolerance: float = EXACT


def motion(spec: mujoco.MjSpec, given: dict[str, Any], ask: Question, seed: int) -> np.ndarray:
    """Simulate a variant for `STEPS`; return the motion of the original's bodies.

    Returns:
        Linear and angular velocities, rotated and scaled back, shape (nbody, 2, 3).
    """
    names = [body.name for body in spec.bodies[1:]]
    spec = spec.copy()
    ask.change(spec)
    model = spec.compile()
    mirrored, speed = np.linalg.det(ask.turn), math.sqrt(ask.scale)
    model.opt.timestep = TIMESTEP * speed / ask.refine
    data = mujoco.MjData(model)
    rng = np.random.default_rng(seed)
    data.qvel[:] = rng.normal(size=model.nv) + ask.nudge * rng.normal(size=model.nv)
    image = ask.turn if mirrored < 0 else np.eye(3)  # of the body frame
    for kind, at in zip(model.jnt_type, model.jnt_dofadr, strict=True):
        if kind == _FREE:
            data.qvel[at : at + 3] = speed * (ask.turn @ data.qvel[at : at + 3])
            at += 3
        if kind in (_FREE, int(mujoco.mjtJoint.mjJNT_BALL)):
            data.qvel[at : at + 3] = mirrored / speed * 5.0 * (image @ data.qvel[at : at + 3])
        else:
            data.qvel[at] *= 5.0 / speed if kind == _HINGE else speed
    given = {**given, **ask.sand}
    sands = [Sand(model, **given)]
    if ask.halves:
        law: Any = sands[0].law
        law = replace(law, scale=0.5 * law.scale)
        sands = [Sand(model, **(given | {"law": law}), shared=True) for _ in range(2)]
    for _ in range(STEPS * ask.refine):
        mujoco.mj_step1(model, data)
        for sand in sands:
            sand.apply(data)
        mujoco.mj_step2(model, data)
    mujoco.mj_forward(model, data)
    found = np.zeros((len(names), 2, 3))
    for row, name in zip(found, names, strict=True):
        out = np.zeros(6)
        body = model.body(name).id
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, out, 0)
        row[0] = ask.turn.T @ out[3:] / speed
        row[1] = mirrored * speed * (ask.turn.T @ out[:3])
    return found


def apart(
    spec: mujoco.MjSpec, given: dict[str, Any], ask: Question, seed: int, than: Question
) -> float:
    """Return the difference in motion of a model and its twin, in parts of the largest speed.

    That speed is at least the initial 1 m/s. Rotation counts at 5 cm, half the size of a body.
    """
    size = np.array([1.0, 0.05])[:, None]
    one = motion(spec, given, than, seed) * size
    two = motion(spec, given, ask, seed) * size
    return float(np.abs(two - one).max() / max(np.abs(one).max(), 1.0))


# Changes of a spec


def moved(spec: mujoco.MjSpec, geom: Any, body: Any, count: int = 1) -> None:
    """Move a geom to a body with the same frame; a box in `count` pieces along its first axes."""
    names = ("name", "type", "size", "pos", "quat", "meshname", "density", "contype", "conaffinity")
    about = {name: getattr(geom, name) for name in names}
    about = {
        name: value.copy() if hasattr(value, "copy") else value for name, value in about.items()
    }
    spec.delete(geom)
    cuts = (count > 1) + 1, (count > 2) + 1
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, about["quat"] / np.linalg.norm(about["quat"]))
    size = about["size"] / [*cuts, 1]
    for k in range(count):
        off = size * [(2 * (k % 2) - 1) * (count > 1), (2 * (k // 2) - 1) * (count > 2), 0]
        piece = {"size": size, "pos": about["pos"] + turn.reshape(3, 3) @ off}
        body.add_geom(
            **{**about, **(piece if count > 1 else {}), "name": f"{about['name']}{k or ''}"}
        )


def reorder(spec: mujoco.MjSpec) -> None:
    """Reverse the order of each body's geoms."""
    for body in spec.bodies[1:]:
        for geom in list(reversed(body.geoms)):
            moved(spec, geom, body)


def weld(spec: mujoco.MjSpec) -> None:
    """Move every other geom of each body to a body that is welded to it."""
    for body in [body for body in spec.bodies[1:] if not body.explicitinertial]:
        child = body.add_body(name=f"{body.name} welded", gravcomp=body.gravcomp)
        for geom in list(body.geoms)[1::2] or list(body.geoms):
            moved(spec, geom, child)


def cut(count: int) -> Callable[[mujoco.MjSpec], None]:
    """Cut boxes into pieces."""

    def change(spec: mujoco.MjSpec) -> None:
        for body in spec.bodies[1:]:
            for geom in [g for g in body.geoms if g.type == mujoco.mjtGeom.mjGEOM_BOX]:
                moved(spec, geom, body, count)

    return change


def place(shift: np.ndarray, turn: np.ndarray) -> Callable[[mujoco.MjSpec], None]:
    """Move and rotate everything in the world."""
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, turn.ravel())

    def change(spec: mujoco.MjSpec) -> None:
        world = spec.worldbody
        for thing in [*world.bodies, *world.geoms]:
            mujoco.mju_mulQuat(thing.quat, quat, thing.quat.copy())
            thing.pos[:] = turn @ thing.pos + shift

    return change


def mirror(spec: mujoco.MjSpec) -> None:
    """Mirror everything in the plane x = 0."""
    for thing in [*spec.bodies[1:], *spec.geoms]:
        thing.pos[0] *= -1
        thing.quat[2:] *= -1
    for body in spec.bodies[1:]:
        body.ipos[0] *= -1
        body.iquat[2:] *= -1
    for joint in spec.joints:
        joint.pos[0] *= -1
        joint.axis[slice(1, 3) if joint.type == mujoco.mjtJoint.mjJNT_HINGE else 0] *= -1
    for mesh in spec.meshes:
        mesh.uservert = (np.reshape(mesh.uservert, (-1, 3)) * [-1, 1, 1]).ravel()


# Questions


def questions(given: dict[str, Any], rng: np.random.Generator) -> Iterator[Question]:
    """Yield the questions with a definite answer for a sand."""
    plane = given["surface"] or Plane()
    flat, grid = isinstance(plane, Plane), "memory" in given
    yield Question("order of geoms", reorder)
    yield Question("two bodies welded", weld)
    if (
        given.get("law") in ("rft2d", "rft3d") and not grid
    ):  # the others are not linear in their scale
        yield Question("two sands", halves=True)
    shift = 0.4 * rng.integers(-3, 4, 3)  # an integer number of cells
    there = {}
    if flat:
        along = math.cos(plane.uphill) * shift[0] + math.sin(plane.uphill) * shift[1]
        height = plane.height + shift[2] - math.tan(plane.slope) * along
        there = {"surface": replace(plane, height=height)}
    yield Question("translation", place(shift, np.eye(3)), there)
    if not grid:
        angle = rng.uniform(-math.pi, math.pi)
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, np.array([math.cos(angle / 2), 0, 0, math.sin(angle / 2)]))
        turn = turn.reshape(3, 3)
        there = {"surface": replace(plane, uphill=plane.uphill + angle)} if flat else {}
        yield Question("rotation", place(np.zeros(3), turn), there, turn)
    if flat and not grid:
        there = {"surface": replace(plane, uphill=math.pi - plane.uphill)}
        mirrored = np.diag([-1.0, 1.0, 1.0])
        # Patches of round geoms and of hulls are not mirrored.
        fine = {"resolution": FINE} if "resolution" in given else {}
        yield Question("mirror", mirror, there | fine, mirrored, tolerance=CUT)


def draw(seed: int, number: int, options: Namespace) -> ModelCase | None:
    """Draw a model under the implicit scheme; None if the number has another."""
    case = motions.draw(seed, number, options)
    if case.program[2] != "implicit" or case.kind == "rest":
        return None
    spec, sand = models.draw_twin(np.random.default_rng([seed, number, 2]), case.program)
    return replace(case, xml=spec.to_xml(), sand=sand, events=[])


def run(case: ModelCase) -> Result:
    """Ask all questions of a model."""
    result, number, rng = Result(), case.number, np.random.default_rng(case.number)
    spec, given = mujoco.MjSpec.from_string(case.xml), arguments(case.sand)
    itself = Question("itself")

    def check(name: str, off: float, most: float) -> None:
        result.counts[name] += 1
        if off > most:
            result.fail(name, f"{off:.3g} of the speed apart")

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        # Where an equation of a step has several solutions, rounding decides between them.
        nudges = [Question("", nudge=10.0**-k) for k in (11, 12, 13)]
        rounding = max(apart(spec, given, nudge, number, itself) for nudge in nudges)
        # Sand with memory is pressed and flows in the order of bodies and cells.
        least = max(10.0 * rounding, CUT if "memory" in given else 0.0)
        for question in questions(given, rng):
            fine = {name: value for name, value in question.sand.items() if name == "resolution"}
            off = apart(spec, given, question, number, itself._replace(sand=fine))
            check(question.name, off, max(question.tolerance, least))
        one, half, quarter = (Question("", refine=k) for k in (1, 2, 4))
        coarse = apart(spec, given, half, number, one)
        check("half step", apart(spec, given, quarter, number, half), max(0.75 * coarse, HALF))
        if case.program[0].startswith("rft"):  # the others act on whole geoms
            spec, box_sand = models.draw_twin(rng, case.program, shape="box")
            # Tracks vary from cell to cell: with memory, facets must be smaller than a cell.
            resolution = FINER if "memory" in given else FINE
            given = {**arguments(box_sand), "resolution": resolution}
            for count in (2, 4):
                off = apart(spec, given, Question("", cut(count)), number, itself)
                check(f"cut in {count}", off, CUT)
    return result
