"""The callback of a training: writes the learning curve and the checkpoints when they are due."""

import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback

from mjgranular._util import files
from mjgranular.errors import UnstableError
from mjgranular.learn.checkpoint import Progress, save_checkpoint
from mjgranular.learn.run import CURVE, Run, curve_text

_ROWS_PER_CHECKPOINT = 5  # of the learning curve
_NEWEST = 20  # episodes in the reported mean return, or one per environment if more; chosen

Report = Callable[[int, float | None], None]
"""Called with the steps done and the mean return of the newest episodes, None before any ends."""


class CheckpointCallback(BaseCallback):
    """Writes curve and checkpoints between rollouts, and ends the training after a signal."""

    def __init__(
        self, run: Run, start: Progress, report: Report | None, received: Sequence[int]
    ) -> None:
        super().__init__()
        self.rollout_start = start.steps  # number of steps at the start of the rollout
        self.stopped = False  # whether a signal ended the training within a rollout
        self._run, self._start, self._report, self._received = run, start, report, received
        self._curve = list(start.curve)
        self._began = time.monotonic()
        self._ended: list[tuple[float, int]] = []  # return and length, since the last row
        self._newest = deque[float](maxlen=max(_NEWEST, run.settings.num_envs))
        self._mean: float | None = None  # of these
        # Rows after the checkpoint that is resumed belong to lost steps.
        self._write_curve()

    def _on_rollout_start(self) -> None:
        before, steps = self.rollout_start, self.num_timesteps
        self.rollout_start = steps
        if self._received:  # the next step ends the training
            return
        every = self._run.settings.checkpoint_every
        row_every = max(1, every // _ROWS_PER_CHECKPOINT)
        if steps // row_every > before // row_every:
            self._add_row()
        if steps // every > before // every:
            self.save()
            restart_episodes(self.model, self._run.seed)
            policy: Any = self.model.policy
            if self.model.use_sde:  # as the algorithm does before each rollout
                policy.reset_noise(self.training_env.num_envs)

    def _on_step(self) -> bool:
        ended = [info["episode"] for info in self.locals["infos"] if "episode" in info]
        if ended:
            self._ended += [(float(one["r"]), int(one["l"])) for one in ended]
            self._newest.extend(float(one["r"]) for one in ended)
            self._mean = float(np.mean(self._newest))
        if self._report is not None:
            self._report(self.num_timesteps, self._mean)
        self.stopped = bool(self._received)
        return not self.stopped

    def save(self) -> Progress:
        check_finite(self.model, self._run)
        self._add_row()
        reached = Progress(self.model.num_timesteps, self._seconds(), tuple(self._curve))
        save_checkpoint(self._run, self.model, reached)
        return reached

    def _seconds(self) -> float:
        """Return the time spent in training, in all processes [s]."""
        return self._start.seconds + time.monotonic() - self._began

    def _add_row(self) -> None:
        """Add the episodes since the last row to the curve."""
        if not self._ended:
            return
        returns, lengths = np.array(self._ended).T
        steps, seconds = self.model.num_timesteps, round(self._seconds(), 3)
        row = (steps, seconds, len(returns), float(returns.mean()), float(lengths.mean()))
        self._curve.append(row)
        self._ended = []
        self._write_curve()

    def _write_curve(self) -> None:
        files.write_text(self._run.path / CURVE, curve_text(self._curve))


def restart_episodes(model: Any, seed: int) -> None:
    """Begin new episodes, with random numbers that follow from the seed and the steps done."""
    word = int(np.random.SeedSequence([seed, model.num_timesteps]).generate_state(1)[0]) % 2**31
    model.set_random_seed(word)
    model._last_obs = model.env.reset()
    model._last_episode_starts = np.ones(model.env.num_envs, dtype=bool)
    model._last_original_obs = model.get_vec_normalize_env().get_original_obs()


def check_finite(model: Any, run: Run) -> None:
    """Raise `UnstableError` if a weight of the policy is not finite."""
    if not all(bool(torch.isfinite(p).all()) for p in model.policy.parameters()):
        raise UnstableError(
            f"{run.name}: weights of the policy are not finite after {model.num_timesteps} steps; "
            "earlier checkpoints are intact: start a new run with a smaller learning_rate"
        )
