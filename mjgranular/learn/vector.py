"""A vector environment of Gymnasium's as a `VecEnv` of Stable-Baselines3."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from stable_baselines3.common.vec_env import VecEnv


class BatchVecEnv(VecEnv):
    """Steps all simulations of a vector environment together.

    Args:
        env: a vector environment that resets in the step that ends an episode
            (`AutoresetMode.SAME_STEP`), as Stable-Baselines3 expects.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any]) -> None:
        if env.metadata.get("autoreset_mode") != AutoresetMode.SAME_STEP:
            raise ValueError("the vector environment must be made with AutoresetMode.SAME_STEP")
        self.env = env
        self.render_mode = env.render_mode
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def reset(self) -> np.ndarray:
        given = any(seed is not None for seed in self._seeds)
        observations, _ = self.env.reset(seed=list(self._seeds) if given else None)
        self._reset_seeds()
        return _narrow(observations)

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        observations, rewards, ended, cut, info = self.env.step(self._actions)
        over = ended | cut
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for index in np.flatnonzero(over):
            infos[index]["terminal_observation"] = _narrow(info["final_obs"][index])
            infos[index]["TimeLimit.truncated"] = bool(cut[index] and not ended[index])
        return _narrow(observations), rewards.astype(np.float32), over, infos

    def close(self) -> None:
        self.env.close()

    def get_images(self) -> Sequence[np.ndarray | None]:
        pictures = self.env.render()
        return list(pictures) if pictures is not None else [None] * self.num_envs

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self.env, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        setattr(self.env, attr_name, value)

    def env_method(
        self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any
    ) -> list[Any]:
        raise NotImplementedError("simulations of a batch have no methods of their own")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False] * len(list(self._get_indices(indices)))


def _narrow(observations: np.ndarray) -> np.ndarray:
    return np.array(observations)
