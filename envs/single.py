"""One simulation of a task, as a Gymnasium environment."""

import copy
from functools import partial
from operator import attrgetter
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np

from mjgranular.envs.cameras import RENDER_MODES, Cameras
from mjgranular.envs.figures import BAD
from mjgranular.envs.ranges import SandRanges
from mjgranular.envs.task import Task, check_actions, get_task


class SandEnv(gym.Env[np.ndarray, np.ndarray]):
    """A task with one simulation.

    `state` is what methods of the task take, views of `data`. A copy or pickle has its task and
    options, not its state: call `reset` first.

    Args:
        task: a task or its name.
        render_mode: None, "human" or "rgb_array".
        width: width of images [px].
        height: height of images [px].
        camera_name: a camera of the model; None for one that follows the robot.
        **options: options of the task, if it is given by name.

    Raises:
        UnknownNameError: no such task, medium, law or camera; lists the valid names.
        InputError: an option that the task does not have, or a value outside its range.
    """

    metadata: dict[str, Any] = {"render_modes": RENDER_MODES}  # noqa: RUF012 - Gymnasium's way

    def __init__(
        self,
        task: str | Task,
        *,
        render_mode: str | None = None,
        width: int = 480,
        height: int = 480,
        camera_name: str | None = None,
        **options: Any,
    ) -> None:
        self.task = get_task(task, options)
        # A copy: what is drawn, such as gravity, stays as built in the model of the task.
        self.model = copy.copy(self.task.model)
        self.data = mujoco.MjData(self.model)
        self.metadata = {**self.metadata, "render_fps": round(1 / self.task.dt)}
        self.render_mode = render_mode
        self.cameras = Cameras(self.task, render_mode, width, height, camera_name)
        self.action_space = self.task.action_space
        self.observation_space = self.task.observation_space
        self.state = self.task.state_of(self.data)
        self._warned = self.data.warning.number[BAD]  # a view
        self._episodes = 0

    def __reduce__(self) -> tuple[Any, ...]:
        return partial(SandEnv, **self.cameras.settings), (self.task,)

    @property
    def dt(self) -> float:
        """Duration of a step [s]."""
        return self.task.dt

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: seed of the random generator; None to go on.
            options: ranges for this episode in place of `randomise` and `curriculum`, by the names
                of `SandRanges`: {"strength": 0.5, "slope": (0, 0.1)}.

        Raises:
            UnknownNameError: another option; lists those that there are.
            InputError: a value outside its range, sand that the model was not made for, or an
                environment without `randomise`.
        """
        task, model, data = self.task, self.model, self.data
        ranges = SandRanges.of_reset(task.randomise, options)
        super().reset(seed=seed)
        random = self.np_random
        sample = task.sample(random, self._episodes, ranges)
        self._episodes += 1
        start = task.begin(random, sample)
        mujoco.mj_resetData(model, data)
        numbers = {name: attrgetter(name)(model) for name in task.varied}
        task.lay(sample, start, self.state, 0, data.plugin_state, numbers)
        mujoco.mj_forward(model, data)
        self.state.found.clear()
        if self.render_mode == "human":
            self.render()
        return task.observation(self.state)[0], first_of(task.reset_info(self.state))

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Advance by `frame_skip` substeps.

        Raises:
            InputError: the action has another shape, or is not finite.
        """
        task, state = self.task, self.state
        action = check_actions(action, self.action_space.shape)[None]
        before = task.mark(state)
        self.data.ctrl[:] = task.act(action, state)[0]
        mujoco.mj_step(self.model, self.data, nstep=task.frame_skip)
        state.found.clear()
        terms = task.rewards(before, action, state)
        lost = any(self._warned.tolist())
        only_step = task.progress(before, state) | terms | {"sand/lost": np.array([lost])}
        if self.render_mode == "human":
            self.render()
        return (
            task.observation(state)[0],
            0.0 if lost else float(task.total(terms)[0]),
            lost or bool(task.terminated(state)[0]),
            False,  # the time limit is in a wrapper
            first_of(task.reset_info(state) | only_step),
        )

    def render(self) -> np.ndarray | None:
        """Render an image, shape (height, width, 3), or to the window."""
        return self.cameras.look(self.model, self.data, int(self.state.active[0]))

    def close(self) -> None:
        self.cameras.close()


def first_of(info: dict[str, np.ndarray]) -> dict[str, Any]:
    """Return the entries of the single simulation: Python numbers, and copies of arrays."""
    return {
        name: value.item() if value.ndim == 1 else value[0].copy() for name, value in info.items()
    }
