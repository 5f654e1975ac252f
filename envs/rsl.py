"""A task in MuJoCo Warp for RSL-RL."""

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from mjgranular._util.checks import check_kind, require
from mjgranular.envs.vector import SandVectorEnv
from mjgranular.errors import InputError

require("rsl_rl", extra="warp", purpose="mjgranular.envs.rsl")

import torch  # noqa: E402 - after the check with the install line
from rsl_rl.env import VecEnv  # noqa: E402
from tensordict import TensorDict  # noqa: E402


class RslVecEnv(VecEnv):
    """A `WarpVectorEnv` or `SandVectorEnv` for the runners of RSL-RL.

    Observations are a `TensorDict` in single precision, with the group `"policy"` and, if the task
    has them (`privileged=True`), what only a critic may know as the group `"privileged"`. Finished
    episodes restart at once; those that were truncated are in `extras["time_outs"]`.

    The environment must be made with `autoreset_mode="SameStep"` and `max_episode_steps`. `device`
    is the PyTorch device of the tensors; None for the CPU.
    """

    def __init__(self, env: SandVectorEnv, device: str | torch.device | None = None) -> None:
        check_kind(env, SandVectorEnv, "RslVecEnv", "WarpVectorEnv(...)")
        if env.autoreset_mode is not AutoresetMode.SAME_STEP or env.max_episode_steps is None:
            raise InputError(
                "RSL-RL needs environments made with autoreset_mode='SameStep' and "
                "max_episode_steps=N"
            )
        self.env = env
        self.num_envs = env.num_envs
        self.num_actions = int(np.prod(env.single_action_space.shape or ()))
        self.max_episode_length = env.max_episode_steps
        self.device = torch.device(device or "cpu")
        self.cfg = {"task": type(env.task).__name__, **env.task.options()}
        self._observations = self._seen(*env.reset())

    def seed(self, seed: int) -> None:
        """Restart all episodes, from a seed."""
        self._observations = self._seen(*self.env.reset(seed=seed))

    @property
    def episode_length_buf(self) -> torch.Tensor:
        """Steps of the episodes, (num_envs,); runners set it to end the first ones apart."""
        return torch.tensor(self.env.elapsed, device=self.device)

    @episode_length_buf.setter
    def episode_length_buf(self, steps: torch.Tensor) -> None:  # pyright: ignore
        self.env.elapsed[:] = steps.cpu()

    def get_observations(self) -> TensorDict:
        return self._observations

    def step(
        self, actions: torch.Tensor
    ) -> tuple[TensorDict, torch.Tensor, torch.Tensor, dict[str, Any]]:
        """Advance all environments; actions are clipped to the task's range."""
        space = self.env.single_action_space
        wanted = actions.detach().cpu().numpy().reshape(self.num_envs, *(space.shape or ()))
        wanted = np.clip(wanted, space.low, space.high)  # pyright: ignore[reportAttributeAccessIssue]
        observations, rewards, terminated, truncated, info = self.env.step(wanted)
        over = torch.as_tensor(terminated | truncated, device=self.device)
        self._observations = self._seen(observations, info)
        rewards = torch.as_tensor(rewards, dtype=torch.float32, device=self.device)
        late = torch.as_tensor(truncated & ~terminated, device=self.device)
        return self._observations, rewards, over, {"time_outs": late}

    def _seen(self, observations: np.ndarray, info: dict[str, Any]) -> TensorDict:
        groups = {"policy": observations}
        if "privileged" in info:
            groups["privileged"] = info["privileged"]
        tensors = {
            name: torch.as_tensor(values, dtype=torch.float32, device=self.device)
            for name, values in groups.items()
        }
        return TensorDict(tensors, batch_size=[self.num_envs], device=self.device)
