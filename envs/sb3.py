"""A batch of simulations for Stable-Baselines3."""

import copy
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

from mjgranular._util.checks import check_count, check_switch, require
from mjgranular.envs.ids import find_spec
from mjgranular.envs.vector import SandVectorEnv
from mjgranular.errors import InputError

require("stable_baselines3", extra="train", purpose="mjgranular.envs.sb3")

from stable_baselines3.common.vec_env import VecEnv  # noqa: E402 - after the check with its install line


class SandVecEnv(VecEnv):
    """A `SandVectorEnv` for Stable-Baselines3: finished episodes restart at once.

    The last observation is in `info["terminal_observation"]`, and `info["TimeLimit.truncated"]` is
    True if the episode was only truncated.

    The batch must be made with `autoreset_mode="SameStep"`. `full_info` returns the complete `info`
    of every simulation at each step; otherwise, which is faster, only where an episode is over.
    """

    def __init__(self, batch: SandVectorEnv, *, full_info: bool = False) -> None:
        if batch.autoreset_mode is not AutoresetMode.SAME_STEP:
            raise InputError(
                "Stable-Baselines3 needs a batch made with autoreset_mode='SameStep', "
                f"not {batch.autoreset_mode.value!r}"
            )
        self.batch, self._full_info = batch, full_info
        self._actions: np.ndarray | None = None
        self._next_seeds: Sequence[int | None] = [None] * batch.num_envs
        super().__init__(batch.num_envs, batch.single_observation_space, batch.single_action_space)

    def reset(self) -> np.ndarray:
        """Begin all episodes, with the seeds of the last `seed` and the last `set_options`."""
        options = self._options[0]
        if any(each != options for each in self._options):
            raise InputError("the simulations of a batch share set_options: give one dictionary")
        observations, info = self.batch.reset(seed=list(self._next_seeds), options=options)
        self._reset_options()
        self._next_seeds = [None] * self.num_envs
        self.reset_infos = _split(info, np.ones(self.num_envs, bool))
        return observations

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Set the seeds of the next reset: consecutive ones from this."""
        if seed is None:
            seed = int(np.random.SeedSequence().generate_state(1)[0])
        self._next_seeds = [seed + number for number in range(self.num_envs)]
        return self._next_seeds

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        if self._actions is None:
            raise InputError("step_async comes before step_wait")
        observations, rewards, terminated, truncated, info = self.batch.step(self._actions)
        self._actions = None
        done = terminated | truncated
        final = info.pop("final_obs", None)
        ended = info.pop("final_info", {})
        if self._full_info:
            infos = _split(info, ~done)
        else:
            infos = [{"TimeLimit.truncated": False} for _ in range(self.num_envs)]
        if done.any():
            last, begun = _split(ended, done), _split(info, done)
            for number in np.flatnonzero(done):
                infos[number] = last[number] | {
                    "terminal_observation": final[number],
                    "TimeLimit.truncated": bool(truncated[number] and not terminated[number]),
                }
                self.reset_infos[number] = begun[number]
        return observations, rewards.astype(np.float32), done, infos

    def close(self) -> None:
        self.batch.close()

    def get_images(self) -> Sequence[np.ndarray | None]:
        frames = self.batch.render()
        return [None] * self.num_envs if frames is None else list(frames)

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of the batch, once for each requested simulation."""
        return [getattr(self.batch, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of the batch."""
        self._check_all(attr_name, indices)
        setattr(self.batch, attr_name, value)

    def env_method(
        self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any
    ) -> list[Any]:
        """Call a method of the batch, and return its result once for each simulation."""
        self._check_all(method_name, indices)
        if method_name == "reset":
            raise InputError("a batch is reset as a whole: use reset()")
        result = getattr(self.batch, method_name)(*args, **kwargs)
        return [result] * self.num_envs

    def _check_all(self, name: str, indices: Any) -> None:
        if len(set(self._get_indices(indices))) < self.num_envs:
            raise InputError(
                f"the {self.num_envs} simulations of a batch share {name!r}: omit indices, got "
                f"{indices}"
            )

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Return False for each simulation: batches are not wrapped."""
        return [False for _ in self._get_indices(indices)]


def make_vec_env(
    environment: str,
    num_envs: int,
    *,
    seed: int | None = None,
    full_info: bool = False,
    warp: str | None = None,
    **options: Any,
) -> SandVecEnv:
    """Return a batch for Stable-Baselines3.

    Args:
        environment: Gymnasium id, such as `mjgranular/ChainSwim-v0`.
        num_envs: number of simulations.
        seed: seed of the first reset; None for a random one.
        full_info: as for `SandVecEnv`.
        warp: device of MuJoCo Warp that steps them (`WarpVectorEnv`): "cuda:0", "cpu", or "auto"
            for a GPU if there is one; None for MuJoCo on all cores.
        **options: options of the environment.

    Raises:
        UnknownNameError: no such environment.
        InputError: an environment without a batch in mjgranular.
    """
    check_count("num_envs", num_envs)
    check_switch("full_info", full_info)
    if seed is not None:
        check_count("seed", seed, least=0)
    spec = find_spec(environment)
    if spec.vector_entry_point != "mjgranular.envs.vector:SandVectorEnv":
        raise InputError(
            f"{environment} has no batch of mjgranular's; "
            "stable_baselines3.common.env_util.make_vec_env takes any environment"
        )
    if warp is not None:
        require("mujoco_warp", extra="warp", purpose="An environment on MuJoCo Warp")
        spec = copy.deepcopy(spec)
        spec.vector_entry_point = "mjgranular.envs:WarpVectorEnv"
        options["device"] = None if warp == "auto" else warp
    batch = gym.make_vec(
        spec,
        num_envs=num_envs,
        vectorization_mode="vector_entry_point",
        autoreset_mode=AutoresetMode.SAME_STEP,
        **options,
    )
    assert isinstance(batch, SandVectorEnv)
    vec = SandVecEnv(batch, full_info=full_info)
    if seed is not None:
        vec.seed(seed)
    return vec


def _split(info: dict[str, Any], mask: np.ndarray) -> list[dict[str, Any]]:
    """Return the `info` of each simulation of the mask, empty ones of the others."""
    infos: list[dict[str, Any]] = [{} for _ in mask]
    for name, value in info.items():
        if f"_{name}" in info:
            for number in np.flatnonzero(mask & info[f"_{name}"]):
                infos[number][name] = value[number]
    return infos
