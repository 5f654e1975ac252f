"""Evaluation of an agent: returns over many seeds, with confidence intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mjgranular._util.checks import check_count, kind_of
from mjgranular._util.extras import require
from mjgranular.errors import InputError
from mjgranular.learn.agents import Agent
from mjgranular.learn.episodes import Episodes, run_episodes
from mjgranular.learn.settings import toml_value

FIRST_SEED = 10_000
"""Far from the usual training seeds: no episode of the training is repeated."""
LEAST_SEEDS = 2
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Mean:
    """A mean with its confidence interval, from Student's t distribution.

    Attributes:
        mean: mean of the values.
        low: lower end of the 95 % interval.
        high: upper end.
        values: one for each seed.
    """

    mean: float
    low: float
    high: float
    values: tuple[float, ...]

    def __str__(self) -> str:
        return f"{self.mean:.4g} ± {(self.high - self.low) / 2:.2g}"


def mean_of(values: Sequence[float] | np.ndarray) -> Mean:
    """Return the mean of at least two values and its 95 % confidence interval."""
    stats = require("scipy.stats", extra="train", purpose="Evaluating policies")
    array = np.asarray(values, dtype=float)
    if array.size < LEAST_SEEDS:
        raise InputError(f"an interval needs at least {LEAST_SEEDS} seeds, not {array.size}")
    mean = float(array.mean())
    error = float(array.std(ddof=1)) / np.sqrt(array.size)
    half = float(stats.t.ppf((1 + CONFIDENCE) / 2, array.size - 1)) * error
    return Mean(mean, mean - half, mean + half, tuple(float(value) for value in array))


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
        """The return."""
        return mean_of(self.episodes.returns)

    @property
    def length(self) -> Mean:
        """Steps of an episode."""
        return mean_of(self.episodes.lengths)

    def figure(self, name: str) -> Mean | None:
        """Return the mean over episodes of a number in `info`; None if the environment has none."""
        values = self.episodes.figures.get(name)
        return None if values is None else mean_of(values)

    def as_json(self) -> dict[str, Any]:
        """Return plain values."""

        def plain(mean: Mean) -> dict[str, Any]:
            return {"mean": mean.mean, "low": mean.low, "high": mean.high, "values": mean.values}

        figures = {name: mean_of(values) for name, values in self.episodes.figures.items()}
        return {
            "agent": self.agent,
            "environment": self.environment,
            "variant": self.variant,
            "seeds": self.episodes.seeds.tolist(),
            "return": plain(self.returned),
            "length": plain(self.length),
            "figures": {
                name: plain(mean) for name, mean in figures.items() if np.isfinite(mean.mean)
            },
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
    progress: Callable[[int], None] | None = None,
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
        progress: called with the number of episodes done.

    Raises:
        InputError: fewer than two seeds, or a variant that is not of this form.
    """
    if not callable(make_agent):
        raise InputError(
            "make_agent is a function that is given the environments and gives who acts in them, "
            f"lambda env: policy for example, not {kind_of(make_agent)}"
        )
    check_seeds(seeds, first_seed)
    episodes = run_episodes(
        env_id,
        {**arguments, **parse_variant(variant)},
        make_agent,
        range(first_seed, first_seed + seeds),
        progress=progress,
    )
    return Score(agent, env_id, variant, episodes)


def check_seeds(seeds: int, first_seed: int = FIRST_SEED) -> None:
    """Check that seeds suffice for an evaluation.

    Raises:
        InputError: they do not; says what would.
    """
    check_count("seeds", seeds)
    check_count("first_seed", first_seed, least=0)
    if seeds < LEAST_SEEDS:
        raise InputError(f"an evaluation needs at least {LEAST_SEEDS} seeds, not {seeds}")


def parse_variant(text: str) -> dict[str, Any]:
    """Return the arguments of an environment from `name=value,name=value`; values as in TOML.

    Raises:
        InputError: not of this form.
    """
    arguments: dict[str, Any] = {}
    for part in split_values(text):
        name, given, value = part.partition("=")
        if not given or not name.strip().isidentifier():
            raise InputError(
                f"a variant of an environment is NAME=VALUE,NAME=VALUE, for example "
                f"medium=glass_beads; not {text!r}"
            )
        arguments[name.strip()] = toml_value(value)
    return arguments


def split_values(text: str) -> list[str]:
    """Split a string at commas that are not within brackets."""
    parts, depth = [""], 0
    for character in text:
        depth += (character in "[{") - (character in "]}")
        if character == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += character
    return [part for part in parts if part.strip()]
