"""Identifiability: which constants the data determine, and which further test would."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mjgranular.errors import GranularError
from mjgranular.fit.body import Body
from mjgranular.fit.constants import Material
from mjgranular.fit.drop import DropTrial
from mjgranular.fit.intervals import SMALLEST
from mjgranular.fit.plan import planned_drag, planned_drop, planned_push
from mjgranular.fit.problem import Problem
from mjgranular.fit.push import PushTrial
from mjgranular.fit.result import FurtherTest, Valley
from mjgranular.fit.trial import Trial

TANGLED = 0.96
"""Multiple correlation of a constant with the others above which it is not identifiable.

Chosen: strength and inertia have 0.98 in drops of one sphere at any one speed, and 0.94 in drops at
two speeds with a ratio of two.
"""
WIDE = 0.5
"""Half width of an interval in parts of the value, above which it is not identifiable; chosen."""

_OTHER_SPEED = 1.5  # least ratio of two different speeds; chosen
_TAKES_PART = 0.15  # least part in a valley, relative to its largest; chosen
_FASTEST = 6.0  # a fall of 1.8 m [m/s]
_OTHER = 3.0  # factor for faster, slower, heavier; chosen
_SHOWN = 4


def trades_off(trials: Sequence[Trial], material: Material, names: Sequence[str]) -> np.ndarray:
    """Return which constants trade off because all runs have one speed, shape (constants,).

    Static and rate-dependent resistance are then separated only by the shape of one kind of curve,
    which assumes an exact law. A comparison with discrete elements (docs/calibration.md): constants
    that fit a sphere at 1 m/s within 0.3 % are 29 % wrong at 3 m/s.
    """
    speeds = [speed for trial in trials for speed in trial.speeds]
    by_speed = np.array([material.by_speed(name) for name in names])
    several = max(speeds) > _OTHER_SPEED * min(speeds)
    if several or by_speed.all() or not by_speed.any():
        return np.zeros(len(names), bool)
    return np.ones(len(names), bool)


@dataclass(frozen=True)
class Information:
    """Information of runs about constants: derivatives for relative changes, touches eliminated."""

    matrix: np.ndarray

    @classmethod
    def of(cls, jacobian: np.ndarray, scale: np.ndarray) -> Information:
        """Return that of a problem's derivatives; the first columns are the constants."""
        constants = jacobian[:, : len(scale)] * scale
        touches = jacobian[:, len(scale) :]
        touches = touches[:, np.abs(touches).max(axis=0, initial=0.0) > 0]
        if touches.shape[1]:
            Q, _ = np.linalg.qr(touches)
            constants = constants - Q @ (Q.T @ constants)
        return cls(constants.T @ constants)

    def plus(self, other: Information) -> Information:
        """Return the sum of both."""
        return Information(self.matrix + other.matrix)

    @property
    def inverse(self) -> np.ndarray:
        """The covariance of the constants up to a factor."""
        values, vectors = np.linalg.eigh(self.matrix)
        least = max(values.max(), 1e-300) * SMALLEST**2
        return (vectors / np.maximum(values, least)) @ vectors.T

    def tangled(self) -> np.ndarray:
        """Return the multiple correlation of each constant with the others, shape (constants,)."""
        own = np.diag(self.matrix)
        square = 1 - 1 / np.maximum(own * np.diag(self.inverse), 1.0)
        silent = own <= SMALLEST**2 * max(own.max(), 1e-300)
        return np.where(silent, 1.0, np.sqrt(np.maximum(square, 0.0)))

    def valleys(self, names: Sequence[str], one_speed: bool) -> tuple[Valley, ...]:
        """Return the null directions: the flattest direction, and all others that are flat."""
        values, vectors = np.linalg.eigh(self.matrix)
        found = []
        for k, value in enumerate(values):
            if k > 0 and value > SMALLEST * values.max():
                break
            v = vectors[:, k] / vectors[np.argmax(np.abs(vectors[:, k])), k]
            change = {n: float(c) for n, c in zip(names, v, strict=True) if abs(c) >= _TAKES_PART}
            effect = 0.1 * float(np.sqrt(max(v @ self.matrix @ v, 0.0)))
            found.append(Valley(change, effect, one_speed))
        return tuple(found)


def further_tests(
    problem: Problem,
    material: Material,
    now: Information,
    half: np.ndarray,
    scale: np.ndarray,
) -> tuple[FurtherTest, ...]:
    """Propose further tests, simulated with the fitted law; the most useful first.

    Args:
        problem: the fit.
        material: the material with the fitted constants.
        now: information of the data.
        half: half widths of the intervals, in parts of each value.
        scale: scale of the constants.
    """
    names = problem.free
    before = np.sqrt(np.diag(now.inverse))
    unit = float(
        np.median(np.where(np.isfinite(half), half, 0.1) / before)
    )  # from derivatives to intervals, as in the fit
    found = []
    for what, trial in _candidates(problem.trials, material):
        try:
            added = _information(trial, material, names, scale)
        except GranularError:
            continue  # for example, the law has no elements for that body
        both = now.plus(added)
        apart = not trades_off((*problem.trials, trial), material, names).any()
        after = unit * np.sqrt(np.diag(both.inverse))
        good = apart and bool((both.tangled() < TANGLED).all() and (after <= WIDE).all())
        width = {name: float(w) for name, w in zip(names, after, strict=True)}
        found.append((float(np.max(after)), FurtherTest(what, width, good)))
    found.sort(key=lambda pair: (not pair[1].identifiable, pair[0]))
    return tuple(test for _, test in found[:_SHOWN])


def _information(
    trial: Trial, material: Material, names: Sequence[str], scale: np.ndarray
) -> Information:
    problem = Problem([trial], material, names)
    # Strength is a factor on the fitted material.
    return Information.of(problem.jacobian(problem.start()), np.where(scale != 0, scale, 1.0))


def _candidates(trials: Sequence[Trial], material: Material) -> Iterator[tuple[str, Trial]]:
    """Yield tests with the available bodies, with descriptions."""
    drops = [t for t in trials if type(t) is DropTrial]
    pushes = [t for t in trials if isinstance(t, PushTrial)]
    bodies = [t.run.body for t in (*drops, *pushes) if t.run.body is not None]
    if not bodies:
        return
    body = bodies[0]
    depths = [float(t.arrest.depth) for t in drops] + [float(t.places.max()) for t in pushes]
    depth = max(min(depths), 0.2 * body.diameter)
    duration = 3 * max([t.arrest.time or 0.05 for t in drops], default=0.1)
    speeds = [t.run.speed or 0.0 for t in drops if t.run.body == body]
    angle = drops[0].run.angle if drops else 0.0

    def drop(what: str, thrown: Body, speed: float) -> Iterator[tuple[str, Trial]]:
        try:
            yield what, planned_drop(thrown, speed, angle, duration, material)
        except GranularError:
            return

    wanted = (min(speeds) / _OTHER, min(max(speeds) * _OTHER, _FASTEST)) if speeds else (1.0, 3.0)
    for speed in wanted:
        if all(not 1 / _OTHER_SPEED < speed / max(v, 1e-9) < _OTHER_SPEED for v in speeds):
            yield from drop(f"a drop of the {body.describe()} at {speed:.2g} m/s", body, speed)
    if speeds:
        heavy = body.heavier(_OTHER)
        yield from drop(f"a drop of a {heavy.describe()} at {speeds[0]:.2g} m/s", heavy, speeds[0])
    plain = replace(body, mass=None, density=None)
    size = plain.describe()
    if not any(type(t) is PushTrial for t in trials):
        slow = "pushed down slowly, force against depth"
        yield f"the {size} {slow}", planned_push(plain, depth, material)
        if plain.shape != "plate":
            side = plain.diameter if plain.length is None else plain.length / 2
            plate = Body("plate", side / 5, side)
            yield f"a {plate.describe()} {slow}", planned_push(plate, depth, material)
    yield (
        f"the {size} drawn along at a depth of {depth * 1e3:.2g} mm, force against speed to 1 m/s",
        planned_drag(plain, depth, material),
    )
