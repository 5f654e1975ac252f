"""Would processes make a fit faster? Its Jacobian's columns done by two, against the fit as it is.

    python scripts/attacks/fitting.py

Fits `docs/models/calibration` as docs/calibration.md does, and six times as many runs, alone and
with columns by two processes, in turn, and compares the constants. Needs the extra `fit`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from mjgranular.fit import read_fit, run_fit
from mjgranular.fit.constants import Material
from mjgranular.fit.fit import _TRIALS, Fit
from mjgranular.fit.problem import Problem
from mjgranular.fit.trial import Trial

_RUNS = Path(__file__).resolve().parents[2] / "docs" / "models" / "calibration" / "runs.yaml"
_there: list[Trial] = []  # runs as each process has read them


def fit_of(copies: int) -> Fit:
    """The fit of docs/calibration.md, or of several copies of all its runs."""
    held = ["rod1", "rod3"] if copies == 1 else []
    fit = read_fit(_RUNS, law="rft3d", free=["strength", "inertia"], hold_out=held)
    if copies == 1:
        return fit
    many = (replace(run, name=f"{run.name}-{k}") for k in range(copies) for run in fit.runs)
    return replace(fit, runs=tuple(many))


def names_of(fit: Fit) -> list[str]:
    """Of the runs that are fitted to."""
    return [run.name for run in fit.runs if run.name not in fit.hold_out]


def begin(copies: int) -> None:
    """Reads the runs, in a process."""
    fit = fit_of(copies)
    known = names_of(fit)
    _there.extend(_TRIALS[run.kind](run) for run in fit.runs if run.name in known)


def column(given: tuple[Material, tuple[str, ...], np.ndarray]) -> np.ndarray:
    """Residuals at one place, in a process."""
    material, free, x = given
    return Problem(_there, material, free).residual(x)


def shared(
    pool: Any, names: list[str], alone: Callable[[Problem, np.ndarray], np.ndarray]
) -> Callable[[Problem, np.ndarray], np.ndarray]:
    """`Problem.jacobian`, of which processes have filled in what each constant does."""

    def jacobian(self: Problem, x: np.ndarray) -> np.ndarray:
        if [trial.name for trial in self.trials] != names:
            return alone(self, x)  # of a further test that is thought about
        asked: list[np.ndarray] = []
        residual = self.residual
        self.residual = lambda y: asked.append(y.copy()) or np.zeros(1)  # pyright: ignore
        alone(self, x)
        first = asked[: 2 * self.count]
        found = pool.map(column, [(self.material, self.free, y) for y in first], chunksize=1)
        rest = iter([*found, *map(residual, asked[2 * self.count :])])
        self.residual = lambda _y: next(rest)  # pyright: ignore
        result = alone(self, x)
        del self.residual
        return result

    return jacobian


def main(rounds: int = 3) -> None:
    """Compares and prints."""
    alone = Problem.jacobian
    for copies in (1, 6):
        fit = fit_of(copies)
        found = expected = run_fit(fit)  # which compiles
        times: dict[str, list[float]] = {"alone": [], "shared": [], "start": []}
        for _ in range(rounds if copies == 1 else 1):
            began = time.perf_counter()
            expected = run_fit(fit)
            times["alone"].append(time.perf_counter() - began)
            began = time.perf_counter()
            with get_context("spawn").Pool(2, begin, (copies,)) as pool:
                pool.map(abs, range(8), chunksize=1)
                times["start"].append(time.perf_counter() - began)
                Problem.jacobian = shared(pool, names_of(fit), alone)  # pyright: ignore
                try:
                    found = run_fit(fit)
                finally:
                    Problem.jacobian = alone
                times["shared"].append(time.perf_counter() - began)
        assert found.values == expected.values
        each = {name: min(values) for name, values in times.items()}
        print(
            f"{len(fit.runs)} runs: alone {each['alone']:.1f} s, columns by two processes "
            f"{each['shared']:.1f} s, of which their start {each['start']:.1f} s; "
            f"{expected.evaluations} runs simulated, {found.evaluations} of them not for columns",
            flush=True,
        )


if __name__ == "__main__":
    main()
