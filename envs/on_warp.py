"""A task in many worlds of MuJoCo Warp, as a Gymnasium vector environment."""

from __future__ import annotations

from typing import Any

import numpy as np

from mjgranular.envs.task import Task
from mjgranular.envs.vector import SandVectorEnv


class WarpVectorEnv(SandVectorEnv):
    """A task with many simulations, stepped by MuJoCo Warp on a GPU or on the processor.

    Observations, rewards, ends, `info` and seeds are as for `SandVectorEnv`, in single precision
    and with the integrator `discrete` (docs/warp.md). A world whose state becomes NaN ends its
    episode, with `info["sand/lost"]`; the others continue.

    Args:
        task: a task or its name.
        num_envs: number of simulations.
        device: Warp device: "cuda:0", "cpu"; None for a GPU if there is one.
        **kwargs: as for `SandVectorEnv`, options of the task among them.

    Raises:
        UnknownNameError: as for `SandVectorEnv`.
        InputError: sand that is not supported in MuJoCo Warp, such as a medium per world.
        MissingExtraError: MuJoCo Warp is not installed.
    """

    def __init__(
        self, task: str | Task, num_envs: int = 1, *, device: str | None = None, **kwargs: Any
    ) -> None:
        self._device = device
        super().__init__(task, num_envs, **kwargs)
        self._settings["device"] = device

    def step(
        self, actions: Any
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Advance every simulation by `frame_skip` substeps, or begin its next episode."""
        observation, reward, terminated, truncated, info = super().step(actions)
        info["sand/lost"] = self.batch.lost.copy()
        return observation, reward, terminated, truncated, info

    def _make_batch(self, threads: int) -> Any:
        from mjgranular.envs.worlds import Worlds  # imports MuJoCo Warp only when needed

        return Worlds(self.task, self.num_envs, self._device)

    def _terminated(self) -> np.ndarray:
        return super()._terminated() | self.batch.lost
