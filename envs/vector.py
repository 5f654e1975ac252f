"""Many simulations of a task, in threads or in MuJoCo Warp, as Gymnasium vector environments."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import mujoco
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from mujoco.batch import Batch

from mjgranular._util.checks import check_count, kind_of
from mjgranular.envs.cameras import RENDER_MODES, Cameras
from mjgranular.envs.figures import BAD
from mjgranular.envs.ranges import SandRanges
from mjgranular.envs.task import Task, check_actions, get_task
from mjgranular.errors import InputError, UnknownNameError


class SandVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """A task with many simulations, stepped by `mujoco.batch.Batch` on all cores.

    Observations, rewards, ends, `info` and random generators are bit-identical to those of
    `num_envs` `SandEnv` in Gymnasium's `SyncVectorEnv`, for any number of threads. `state` is what
    methods of the task take.

    Args:
        task: a task or its name.
        num_envs: number of simulations.
        max_episode_steps: steps after which an episode is truncated; None for never.
        autoreset_mode: when a finished episode restarts.
        threads: number of threads; 0 for one per core.
        render_mode: None or "rgb_array"; other arguments and errors are those of `SandEnv`.
    """

    def __init__(
        self,
        task: str | Task,
        num_envs: int = 1,
        *,
        max_episode_steps: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        threads: int = 0,
        render_mode: str | None = None,
        width: int = 480,
        height: int = 480,
        camera_name: str | None = None,
        **options: Any,
    ) -> None:
        super().__init__()
        check_count("num_envs", num_envs)
        check_count("threads", threads, least=0)
        if max_episode_steps is not None:
            check_count("max_episode_steps", max_episode_steps)
        modes = [mode.value for mode in AutoresetMode]
        if not isinstance(autoreset_mode, AutoresetMode) and autoreset_mode not in modes:
            raise UnknownNameError("autoreset_mode", autoreset_mode, modes)
        if render_mode == "human":
            raise InputError("a batch has no window: render_mode must be None or 'rgb_array'")
        self.task = get_task(task, options)
        self.num_envs, self.max_episode_steps = num_envs, max_episode_steps
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {
            "render_modes": [mode for mode in RENDER_MODES if mode != "human"],
            "render_fps": round(1 / self.task.dt),
            "autoreset_mode": self.autoreset_mode,
        }
        self.render_mode = render_mode
        self.cameras = Cameras(self.task, render_mode, width, height, camera_name)
        self.single_observation_space = self.task.observation_space
        self.single_action_space = self.task.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._settings = {
            "max_episode_steps": max_episode_steps,
            "autoreset_mode": self.autoreset_mode,
            "threads": threads,
            **self.cameras.settings,
        }
        self.batch = self._make_batch(threads)
        self.state = self.task.new_state({name: self.batch.bind(name) for name in self.task.bound})
        self._ctrl = self.batch.bind("ctrl")
        self._plugin_state = self.batch.bind("plugin_state")
        self._numbers = {name: self.batch.expand(name) for name in self.task.varied}
        self._randoms: list[np.random.Generator | None] = [None] * num_envs
        self._seeds: list[int | None] = [None] * num_envs
        self._episodes = np.zeros(num_envs, int)
        self.elapsed = np.zeros(num_envs, int)
        self._over = np.zeros(num_envs, bool)

    def __reduce__(self) -> tuple[Any, ...]:
        return partial(type(self), **self._settings), (self.task, self.num_envs)

    @property
    def np_random(self) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Random generators of the simulations, as in `SyncVectorEnv`."""
        return tuple(self._random(number) for number in range(self.num_envs))

    @property
    def np_random_seed(self) -> Any:
        """Seeds of the simulations, as in `SyncVectorEnv`."""
        _ = self.np_random
        return tuple(self._seeds)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin episodes.

        Args:
            seed: seed of the first simulation, followed by consecutive ones; or one for each.
            options: `reset_mask`, a bool for each simulation, resets some; others are those of
                `SandEnv.reset`, for the episodes that begin.
        """
        others = dict(options) if isinstance(options, Mapping) else options
        mask = others.pop("reset_mask", None) if isinstance(others, dict) else None
        ranges = SandRanges.of_reset(self.task.randomise, others)
        if seed is None:
            seeds: list[int | None] = [None] * self.num_envs
        elif isinstance(seed, (int, np.integer)):
            seeds = [int(seed) + number for number in range(self.num_envs)]
        elif isinstance(seed, (list, tuple, np.ndarray)):
            seeds = list(seed)
        else:
            raise InputError(f"a seed must be an integer, or a list of them, not {kind_of(seed)}")
        if len(seeds) != self.num_envs:
            raise InputError(f"{self.num_envs} simulations need as many seeds, not {len(seeds)}")
        chosen = np.ones(self.num_envs, bool) if mask is None else np.asarray(mask)
        if chosen.shape != (self.num_envs,) or chosen.dtype != bool or not chosen.any():
            raise InputError(
                f"reset_mask must be {self.num_envs} bools of which one is true, not {chosen}"
            )
        for number in np.flatnonzero(chosen):
            if seeds[number] is not None:
                self._randoms[number], self._seeds[number] = seeding.np_random(seeds[number])
        self._begin(np.flatnonzero(chosen), ranges)
        info: dict[str, Any] = {}
        _add(info, self.task.reset_info(self.state), chosen)
        return self.task.observation(self.state), info

    def step(
        self, actions: Any
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Advance every simulation by `frame_skip` substeps, or begin its next episode.

        Raises:
            InputError: the actions have another shape, or are not finite; or there was no reset.
        """
        task, state = self.task, self.state
        actions = check_actions(actions, self.action_space.shape)
        if not self._episodes.all():
            raise InputError("simulations must be reset before they are stepped: call reset()")
        again = self._over.copy()
        if self.autoreset_mode is not AutoresetMode.NEXT_STEP and again.any():
            raise InputError(
                f"simulations {np.flatnonzero(again).tolist()} are over: reset them with "
                "reset(options={'reset_mask': ...}) before they are stepped"
            )
        stepped = ~again
        before = task.mark(state)
        if stepped.any():
            self._ctrl[:] = task.act(actions, state)
            ids = None if not again.any() else np.flatnonzero(stepped)
            self.batch.step(ids, nstep=task.frame_skip)
            state.found.clear()
        self.elapsed += 1
        lost = self.batch.warning[:, BAD, 1].any(axis=1)
        terms = task.rewards(before, actions, state)
        only_step = task.progress(before, state) | terms | {"sand/lost": lost}
        rewards = np.where(again | lost, 0.0, task.total(terms))
        terminated = task.terminated(state) | lost
        truncated = self.elapsed >= (self.max_episode_steps or np.inf)
        info: dict[str, Any] = {}
        if again.any():
            self._begin(np.flatnonzero(again), task.randomise)
            terminated[again] = truncated[again] = False
        over = terminated | truncated
        self._over = over.copy()  # `_begin` changes it
        if self.autoreset_mode is AutoresetMode.SAME_STEP and over.any():
            self._finish(info, over, only_step)
            self._begin(np.flatnonzero(over), task.randomise)
            stepped = ~over
        _add(info, only_step, stepped)
        _add(info, task.reset_info(state), np.ones(self.num_envs, bool))
        return task.observation(state), rewards, terminated, truncated, info

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Render an image of each simulation, shape (height, width, 3)."""
        if self.render_mode is None:
            return None
        frames = []
        for number in range(self.num_envs):
            model, data = self.batch.get_model(number), self.batch.get_data(number)
            mujoco.mj_forward(model, data)
            frames.append(self.cameras.look(model, data, int(self.state.active[number])))
        return tuple(frames)

    def close_extras(self, **kwargs: Any) -> None:
        if "cameras" in vars(self):  # missing if the constructor raised
            self.cameras.close()

    def _make_batch(self, threads: int) -> Any:
        """Make the stepper of the simulations, with the methods of `mujoco.batch.Batch`."""
        return Batch(self.task.model, self.num_envs, threads)

    def _random(self, number: int) -> np.random.Generator:
        random = self._randoms[number]
        if random is None:
            random, self._seeds[number] = seeding.np_random()
            self._randoms[number] = random
        return random

    def _begin(self, ids: np.ndarray, ranges: SandRanges | None) -> None:
        task, state = self.task, self.state
        samples, starts = [], []
        for number in ids:
            random = self._random(number)
            sample = task.sample(random, int(self._episodes[number]), ranges)
            samples.append(sample)
            starts.append(task.begin(random, sample))
        self._episodes[ids] += 1
        self.elapsed[ids] = 0
        self._over[ids] = False
        self.batch.reset(ids, stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        for number, sample, start in zip(ids, samples, starts, strict=True):
            numbers = {name: values[number] for name, values in self._numbers.items()}
            task.lay(sample, start, state, number, self._plugin_state[number], numbers)
        self.batch.forward(ids)
        state.found.clear()

    def _finish(self, info: dict[str, Any], over: np.ndarray, only_step: dict[str, Any]) -> None:
        """Put the last observation and `info` of finished episodes into `info`, as in Gymnasium."""
        last = self.task.observation(self.state)
        final = np.full(self.num_envs, None, object)
        for number in np.flatnonzero(over):
            final[number] = last[number].copy()
        info["final_obs"], info["_final_obs"] = final, over.copy()
        ended: dict[str, Any] = {}
        _add(ended, self.task.reset_info(self.state) | only_step, over)
        info["final_info"], info["_final_info"] = ended, over.copy()


class WarpVectorEnv(SandVectorEnv):
    """A task with many simulations, stepped by MuJoCo Warp on a GPU or on the processor.

    Observations, rewards, ends, `info` and seeds are as for `SandVectorEnv`, in single precision
    and with the integrator `discrete` (docs/warp.md). `device` is Warp's: "cuda:0", "cpu"; None for
    a GPU if there is one. Other arguments are as for `SandVectorEnv`; sand that Warp does not
    support, as a medium per world, is an `InputError`.
    """

    def __init__(
        self, task: str | Task, num_envs: int = 1, *, device: str | None = None, **kwargs: Any
    ) -> None:
        self._device = device
        super().__init__(task, num_envs, **kwargs)
        self._settings["device"] = device

    def _make_batch(self, threads: int) -> Any:
        from mjgranular.envs.worlds import Worlds  # imports MuJoCo Warp only when needed

        return Worlds(self.task, self.num_envs, self._device)


def _add(info: dict[str, Any], values: dict[str, np.ndarray], mask: np.ndarray) -> None:
    """Add entries of the simulations in the mask, each with the mask, as Gymnasium does.

    Others have zeros, or None for what is not a number. Entries that no simulation has are omitted.
    """
    if not mask.any():
        return
    every = mask.all()
    for name, value in values.items():
        if value.dtype == np.float32:  # as Python's numbers in the single environment
            value = value.astype(float)
        if not every:
            value = value.copy()
            value[~mask] = None if value.dtype == object else 0
        info[name], info[f"_{name}"] = value, mask.copy()
