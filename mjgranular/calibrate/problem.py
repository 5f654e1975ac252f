"""All runs of a fit: unknowns and residuals."""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from mjgranular.calibrate.material import Material
from mjgranular.calibrate.motion import Motion
from mjgranular.calibrate.trial import Trial
from mjgranular.errors import UnstableError

_FAR = 10.0  # residual of a run that diverged: ten times what was measured
_FINE = 1e-3  # relative step of a difference; chosen: the error of central ones is its square


class Problem:
    """Unknown constants and touches, and residuals of the runs.

    The unknowns are the free constants, then the touch time of each drop.
    """

    def __init__(
        self,
        trials: Sequence[Trial],
        material: Material,
        free: Sequence[str],
        progress: Callable[[int], None] | None = None,
    ) -> None:
        self.trials, self.material, self.free = tuple(trials), material, tuple(free)
        self.shifted = [k for k, trial in enumerate(trials) if trial.shift is not None]
        bounds = [material.bounds(name) for name in free]
        bounds += [trials[k].shift_range for k in self.shifted]
        self.low, self.high = (np.array(ends, float) for ends in zip(*bounds, strict=True))
        self.count = len(self.free)
        self.range = self.high - self.low  # may be infinite
        self.evaluations = 0
        self._progress = progress
        self._outcomes: dict[tuple[float, ...], list[Motion | None]] = {}

    def sizes(self, constants: np.ndarray) -> np.ndarray:
        """Return the size of each unknown: that of `constants`, and the range of each touch."""
        return np.concatenate([constants[: self.count], self.range[self.count :]])

    def start(self) -> np.ndarray:
        constants = [self.material.value(name) for name in self.free]
        shifts = [self.trials[k].shift for k in self.shifted]
        return np.array([*constants, *shifts], float)

    def material_at(self, x: np.ndarray) -> Material:
        values = {name: float(value) for name, value in zip(self.free, x, strict=False)}
        return self.material.changed(values)

    def shift_of(self, x: np.ndarray, trial: int) -> float | None:
        if trial not in self.shifted:
            return None
        return float(x[self.count + self.shifted.index(trial)])

    def outcomes(self, x: np.ndarray) -> list[Motion | None]:
        """Return the outcome of each run; None for one that diverged."""
        key = tuple(x[: self.count])
        if key not in self._outcomes:
            material = self.material_at(x)
            found = []
            for trial in self.trials:
                try:
                    found.append(trial.simulate(material))
                except UnstableError:
                    found.append(None)
                self.evaluations += 1
                if self._progress is not None:
                    self._progress(self.evaluations)
            self._outcomes[key] = found
        return self._outcomes[key]

    def residual(self, x: np.ndarray) -> np.ndarray:
        parts = []
        for k, outcome in enumerate(self.outcomes(x)):
            trial = self.trials[k]
            if outcome is None:
                parts.append(np.full(trial.rows, _FAR / np.sqrt(trial.rows)))
            else:
                parts.append(trial.residual(outcome, self.shift_of(x, k)))
        return np.concatenate(parts)

    def blocks(self) -> list[slice]:
        """Return the rows of each series of each run among the residuals."""
        return _slices([len(series.values) for trial in self.trials for series in trial.series])

    def runs(self) -> list[slice]:
        """Return the rows of each run among the residuals."""
        return _slices([trial.rows for trial in self.trials])

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Return the derivatives of the residuals, central differences if the bounds allow."""
        columns = []
        for k in range(len(x)):
            if k < self.count:
                step = _FINE * max(abs(x[k]), 1e-3 * abs(self.start()[k]))
            else:
                step = _FINE * self.range[k]
            up, down = x.copy(), x.copy()
            up[k] = min(x[k] + step, self.high[k])
            down[k] = max(x[k] - step, self.low[k])
            columns.append((self.residual(up) - self.residual(down)) / (up[k] - down[k]))
        return np.column_stack(columns)


def _slices(lengths: Sequence[int]) -> list[slice]:
    return [slice(a, b) for a, b in pairwise(np.cumsum([0, *lengths]).tolist())]
