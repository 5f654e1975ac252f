"""Complete episodes, one for each seed, several at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mjgranular.errors import InputError
from mjgranular.learn import environments
from mjgranular.learn.agents import Agent

AT_ONCE = 64
"""Episodes that are stepped together."""
LONGEST = 10_000
"""Steps after which an episode without a limit is ended."""


@dataclass(frozen=True)
class Episodes:
    """Outcome of some episodes.

    Attributes:
        seeds: shape (n,).
        returns: sums of rewards, shape (n,).
        lengths: numbers of steps, shape (n,).
        figures: means over each episode of the numbers in `info`, by name, shape (n,).
    """

    seeds: np.ndarray
    returns: np.ndarray
    lengths: np.ndarray
    figures: dict[str, np.ndarray]


def run_episodes(
    env_id: str,
    arguments: Mapping[str, Any],
    make_agent: Callable[[Any], Agent],
    seeds: Sequence[int],
    *,
    progress: Callable[[int], None] | None = None,
    threads: int | None = None,
) -> Episodes:
    """Run one episode for each seed.

    Args:
        env_id: Gymnasium id.
        arguments: arguments of the environment.
        make_agent: returns the agent for given environments.
        seeds: seeds of the environments' resets.
        progress: called with the number of episodes done.
        threads: threads of a batch of mjgranular's; None for one per core.
    """
    if not seeds:
        raise InputError("at least one seed is needed")
    parts = []
    for first in range(0, len(seeds), AT_ONCE):
        some = list(seeds[first : first + AT_ONCE])
        env = environments.several(env_id, arguments, num_envs=len(some), threads=threads)
        try:
            parts.append(
                _run(env, make_agent(env), some, lambda n, f=first: progress and progress(f + n))
            )
        finally:
            env.close()
    return joined(parts)


def joined(parts: Sequence[Episodes]) -> Episodes:
    """Concatenate episodes, with the figures that all have."""
    names = [name for name in parts[0].figures if all(name in part.figures for part in parts)]
    return Episodes(
        np.concatenate([part.seeds for part in parts]),
        np.concatenate([part.returns for part in parts]),
        np.concatenate([part.lengths for part in parts]),
        {name: np.concatenate([part.figures[name] for part in parts]) for name in names},
    )


def _run(env: Any, agent: Agent, seeds: list[int], progress: Callable[[int], object]) -> Episodes:
    count = len(seeds)
    returns, lengths = np.zeros(count), np.zeros(count, dtype=np.int64)
    running = np.ones(count, dtype=bool)
    sums: dict[str, np.ndarray] = {}
    observations, _ = env.reset(seed=seeds)
    while running.any():
        # Environments that have ended continue until the last has: their steps are not counted.
        actions = agent.act(observations, lengths)
        observations, rewards, ended, cut, info = env.step(actions)
        returns[running] += rewards[running]
        lengths[running] += 1
        for name, values in info.items():
            # Names with a leading underscore say which simulations have the entry.
            if not name.startswith("_") and _is_number_each(values, count):
                total = sums.setdefault(name, np.zeros(count))
                total[running] += values[running]
        running &= ~(ended | cut) & (lengths < LONGEST)
        progress(int(count - running.sum()))
    figures = {name: total / lengths for name, total in sums.items()}
    return Episodes(np.array(seeds), returns, lengths, figures)


def _is_number_each(values: object, count: int) -> bool:
    """Return True if an entry of `info` is one number, or one boolean, for each simulation."""
    return (
        isinstance(values, np.ndarray)
        and values.shape == (count,)
        and (np.issubdtype(values.dtype, np.number) or values.dtype == bool)
    )
