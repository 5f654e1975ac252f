"""What a training leaves in its folder as it goes: rows of the curve and checkpoints."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from mjgranular import files
from mjgranular.errors import UnstableError
from mjgranular.extras import need
from mjgranular.learn.checkpoint import Progress, save_checkpoint
from mjgranular.learn.run import CURVE, Run, curve_text

_ROWS_PER_CHECKPOINT = 5  # of the learning curve
_NEWEST = 20  # episodes that are told of while it goes; chosen


class Keeping:
    """Rows of the curve and checkpoints of a run, each when it is due.

    Args:
        run: whose folder they go to.
        progress: what was done before.
    """

    def __init__(self, run: Run, progress: Progress) -> None:
        self._run, self._before = run, progress
        self._every = run.settings.checkpoint_every
        self._row_every = max(1, self._every // _ROWS_PER_CHECKPOINT)
        self._curve = list(progress.curve)
        self._began = time.monotonic()
        self._ended: list[tuple[float, int]] = []  # episodes since the last row
        self.newest: float | None = None
        """Mean return of the newest episodes; None before the first ends."""
        self._plan(progress.steps)
        # Rows after the checkpoint that is gone on from belong to what was lost.
        files.write_text(run.path / CURVE, curve_text(self._curve))

    def end_episode(self, returned: float, length: int) -> None:
        """Takes note of an episode that has ended."""
        self._ended.append((float(returned), int(length)))
        self.newest = float(np.mean([each for each, _ in self._ended[-_NEWEST:]]))

    def is_due(self, steps: int) -> bool:
        """Adds a row to the curve if it is time, and tells whether it is for a checkpoint."""
        checkpoint = steps >= self._next_checkpoint
        if steps >= self._next_row:
            self._add_row(steps)
        self._plan(steps)
        return checkpoint

    def save(self, model: Any) -> Progress:
        """Writes a checkpoint.

        Raises:
            UnstableError: the policy's numbers are not finite.
        """
        refuse_not_finite(model, self._run)
        self._add_row(model.num_timesteps)
        reached = Progress(model.num_timesteps, self._seconds(), tuple(self._curve))
        save_checkpoint(self._run, model, reached)
        return reached

    def _plan(self, steps: int) -> None:
        self._next_checkpoint = (steps // self._every + 1) * self._every
        self._next_row = (steps // self._row_every + 1) * self._row_every

    def _seconds(self) -> float:
        """Spent in training, this sitting and those before it [s]."""
        return self._before.seconds + time.monotonic() - self._began

    def _add_row(self, steps: int) -> None:
        if not self._ended:
            return
        returns, lengths = zip(*self._ended, strict=True)
        self._curve.append(
            (
                steps,
                round(self._seconds(), 3),
                len(returns),
                float(np.mean(returns)),
                float(np.mean(lengths)),
            )
        )
        self._ended = []
        files.write_text(self._run.path / CURVE, curve_text(self._curve))


def refuse_not_finite(model: Any, run: Run) -> None:
    """Refuses to go on with a policy whose numbers are not finite.

    Raises:
        UnstableError: they are not.
    """
    torch = need("torch", extra="train", purpose="Training a policy")
    if not all(bool(torch.isfinite(p).all()) for p in model.policy.parameters()):
        raise UnstableError(
            f"{run.name}: the policy's numbers are not finite after {model.num_timesteps} steps; "
            "the checkpoints before are whole: begin a new run with a smaller learning_rate"
        )
