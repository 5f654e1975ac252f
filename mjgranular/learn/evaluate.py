"""Evaluation of agents: complete episodes, one per seed, and means with confidence intervals.

Agents that need no training are zero, random and a scripted gait; `policies.Policy` is another.
"""

import copy
import importlib
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import numpy as np

from mjgranular._util.checks import check_count, kind_of, require
from mjgranular.errors import InputError
from mjgranular.learn import environments
from mjgranular.learn.settings import toml_value

BASELINES = ("zero", "random", "gait")
FIRST_SEED = 10_000  # far from the usual training seeds: no episode of the training is repeated
AT_ONCE = 64  # episodes that are stepped together
LONGEST = 10_000  # steps after which an episode without a limit is ended
_LEAST_SEEDS = 2
_CONFIDENCE = 0.95


class Agent(Protocol):
    """Chooses actions for n simulations, shape (n, m).

    `steps` are the numbers of steps since the episodes began, shape (n,).
    """

    def act(self, observations: np.ndarray, steps: np.ndarray) -> np.ndarray: ...


@dataclass(frozen=True)
class Baseline:
    """An agent that observes nothing; `choose` returns actions for numbers of steps."""

    choose: Callable[[np.ndarray], np.ndarray]

    def act(self, observations: np.ndarray, steps: np.ndarray) -> np.ndarray:
        return self.choose(steps)


def make_baseline(
    name: str, env_id: str, env: Any, *, gait: Mapping[str, float] | None = None
) -> Agent:
    """Return an agent that needs no training: one of `BASELINES`.

    "zero" acts with the middle of the action space, or the first of discrete actions. `env` is one
    environment or several, `gait` has the parameters of the gait that differ from its defaults.
    """
    if name == "gait":
        gaits = importlib.import_module("mjgranular.envs.gaits")
        task: Any = getattr(env.unwrapped, "task", None)
        if type(task).__name__ not in gaits.gaits:
            raise InputError(
                f"there is no scripted gait for {env_id}; there are some for "
                f"{', '.join(f'mjgranular/{name}-v0' for name in gaits.gaits)}"
            )
        script = gaits.gait(task, **(gait or {}))
        return Baseline(lambda steps: np.array([script(time) for time in steps * task.dt]))
    space = getattr(env, "single_action_space", None) or env.action_space
    if name == "random":
        return Baseline(partial(_sample, env, space, []))
    middle: Any = 0
    if hasattr(space, "low"):
        middle = np.clip(0.0, space.low, space.high).astype(space.dtype)
    return Baseline(lambda steps: np.array([middle] * len(steps)))


def _sample(env: Any, space: Any, own: list[Any], steps: np.ndarray) -> np.ndarray:
    """Return random actions, in each environment by the seed of its first episode."""
    while len(own) < len(steps):  # seeds are consecutive
        first = np.atleast_1d(getattr(env, "np_random_seed", 0)).tolist()[0]
        own.append(copy.deepcopy(space))
        own[-1].seed(first + len(own) - 1)
    return np.array([each.sample() for each in own])


@dataclass(frozen=True)
class Episodes:
    """Outcome of n episodes: arrays of shape (n,)."""

    seeds: np.ndarray  # seeds of the resets
    returns: np.ndarray  # sums of rewards
    lengths: np.ndarray  # numbers of steps
    figures: dict[str, np.ndarray]  # means over each episode of the numbers in `info`, by name


def run_episodes(
    env_id: str,
    arguments: Mapping[str, Any],
    make_agent: Callable[[Any], Agent],
    seeds: Sequence[int],
) -> Episodes:
    """Run one episode for each seed."""
    parts = []
    for first in range(0, len(seeds), AT_ONCE):
        some = list(seeds[first : first + AT_ONCE])
        with closing(environments.several(env_id, arguments, num_envs=len(some))) as env:
            parts.append(_step_to_end(env, make_agent(env), some))
    names = [name for name in parts[0].figures if all(name in part.figures for part in parts)]
    return Episodes(
        np.concatenate([part.seeds for part in parts]),
        np.concatenate([part.returns for part in parts]),
        np.concatenate([part.lengths for part in parts]),
        {name: np.concatenate([part.figures[name] for part in parts]) for name in names},
    )


def _step_to_end(env: Any, agent: Agent, seeds: list[int]) -> Episodes:
    """Step environments until the first episode of each has ended."""
    count = len(seeds)
    returns, lengths = np.zeros(count), np.zeros(count, dtype=np.int64)
    running = np.ones(count, dtype=bool)
    sums: dict[str, np.ndarray] = {}
    observations, _ = env.reset(seed=seeds)
    while running.any():
        # Environments that have ended continue until the last has: their steps are not counted.
        actions = agent.act(observations, lengths)
        observations, rewards, terminated, truncated, info = env.step(actions)
        returns[running] += rewards[running]
        lengths[running] += 1
        for name, values in info.items():
            # Names with a leading underscore say which simulations have the entry.
            if not name.startswith("_") and _is_number_each(values, count):
                total = sums.setdefault(name, np.zeros(count))
                total[running] += values[running]
        running &= ~(terminated | truncated) & (lengths < LONGEST)
    figures = {name: total / lengths for name, total in sums.items()}
    return Episodes(np.array(seeds), returns, lengths, figures)


def _is_number_each(values: Any, count: int) -> bool:
    """Return True if an entry of `info` is one number, or one boolean, for each simulation."""
    is_row = isinstance(values, np.ndarray) and values.shape == (count,)
    return is_row and (np.issubdtype(values.dtype, np.number) or values.dtype == bool)


@dataclass(frozen=True)
class Mean:
    """A mean with its confidence interval, from Student's t distribution."""

    mean: float  # mean of the values
    low: float  # lower end of the 95 % interval
    high: float  # upper end
    values: tuple[float, ...]  # one for each seed

    def __str__(self) -> str:
        return f"{self.mean:.4g} ± {(self.high - self.low) / 2:.2g}"


def mean_of(values: Sequence[float] | np.ndarray) -> Mean:
    """Return the mean of at least two values and its 95 % confidence interval."""
    stats = require("scipy.stats", extra="train", purpose="Evaluating policies")
    array = np.asarray(values, dtype=float)
    check_seeds(array.size)
    mean = float(array.mean())
    half = float(stats.t.ppf((1 + _CONFIDENCE) / 2, array.size - 1) * stats.sem(array))
    return Mean(mean, mean - half, mean + half, tuple(array.tolist()))


@dataclass(frozen=True)
class Score:
    """Evaluation of one agent in one environment.

    Attributes:
        agent: display name of the agent.
        environment: its id.
        variant: how it differs from the training environment; empty if it does not.
        episodes: outcome of the episodes.
    """

    agent: str
    environment: str
    variant: str
    episodes: Episodes

    @property
    def returned(self) -> Mean:
        return mean_of(self.episodes.returns)

    @property
    def length(self) -> Mean:
        return mean_of(self.episodes.lengths)

    def figure(self, name: str) -> Mean | None:
        """Return the mean over episodes of a number in `info`; None if the environment has none."""
        values = self.episodes.figures.get(name)
        return None if values is None else mean_of(values)

    def as_json(self) -> dict[str, Any]:
        figures = {name: mean_of(values) for name, values in self.episodes.figures.items()}
        finite = {name: vars(mean) for name, mean in figures.items() if np.isfinite(mean.mean)}
        return {
            "agent": self.agent,
            "environment": self.environment,
            "variant": self.variant,
            "seeds": self.episodes.seeds.tolist(),
            "return": vars(self.returned),
            "length": vars(self.length),
            "figures": finite,
        }


def evaluate(
    agent: str,
    make_agent: Callable[[Any], Agent],
    env_id: str,
    arguments: Mapping[str, Any],
    *,
    variant: str = "",
    seeds: int = 10,
    first_seed: int = FIRST_SEED,
) -> Score:
    """Run an agent for one episode per seed.

    Args:
        agent: display name of the agent.
        make_agent: returns the agent for given environments.
        env_id: Gymnasium id.
        arguments: arguments of the environment, without those of the variant.
        variant: `name=value,...`, changes of the arguments; "" for none.
        seeds: number of seeds.
        first_seed: the first of consecutive seeds.

    Raises:
        InputError: fewer than two seeds, or a variant that is not of this form.
    """
    if not callable(make_agent):
        raise InputError(
            "make_agent must be a function of the environments, such as lambda env: policy, got "
            f"{kind_of(make_agent)}"
        )
    check_seeds(seeds, first_seed)
    arguments = {**arguments, **parse_variant(variant)}
    consecutive = range(first_seed, first_seed + seeds)
    return Score(agent, env_id, variant, run_episodes(env_id, arguments, make_agent, consecutive))


def check_seeds(seeds: int, first_seed: int = FIRST_SEED) -> None:
    """Check that there are enough seeds for an evaluation."""
    check_count("seeds", seeds)
    check_count("first_seed", first_seed, least=0)
    if seeds < _LEAST_SEEDS:
        raise InputError(f"an evaluation needs at least {_LEAST_SEEDS} seeds, got {seeds}")


def parse_variant(text: str) -> dict[str, Any]:
    """Return the arguments of an environment from `name=value,name=value`; in TOML, or None."""
    arguments: dict[str, Any] = {}
    for part in _split_at_commas(text):
        name, equals, value = part.partition("=")
        if not equals or not name.strip().isidentifier():
            raise InputError(
                "a variant of an environment must be NAME=VALUE,NAME=VALUE, such as "
                f"medium=glass_beads, got {text!r}"
            )
        arguments[name.strip()] = toml_value(value)
    return arguments


def _split_at_commas(text: str) -> list[str]:
    """Split a string at commas that are not within brackets."""
    parts, depth = [""], 0
    for character in text:
        depth += (character in "[{") - (character in "]}")
        if character == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += character
    return [part for part in parts if part.strip()]
