"""The best of the scripted gaits of an environment, from a grid over their parameters."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from mjgranular.errors import InputError
from mjgranular.learn import environments
from mjgranular.learn.agents import make_gait, task_of
from mjgranular.learn.episodes import Episodes, run_episodes

SEED = 20_000
"""Of the search's episodes; others than those of an evaluation, lest the best be the luckiest."""
_AT_ONCE = 64


@dataclass(frozen=True)
class Found:
    """One gait of a search.

    Attributes:
        parameters: of the gait.
        value: what was asked for: the return, or the mean of a number in `info`.
    """

    parameters: dict[str, float]
    value: float


@dataclass(frozen=True)
class Search:
    """Result of a search.

    Attributes:
        gaits: all of them, the best first.
        edges: parameters whose best value is an end of its range: the best may lie beyond.
    """

    gaits: tuple[Found, ...]
    edges: tuple[str, ...]


def search_gaits(
    env_id: str,
    arguments: Mapping[str, Any],
    *,
    count: int = 200,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    by: str = "return",
    progress: Callable[[int, int], None] | None = None,
) -> Search:
    """Tries a grid of at least `count` gaits, each for one episode from the same start.

    Args:
        env_id: of an environment that has a scripted gait.
        arguments: of the environment.
        count: how many gaits at least; as many values of each parameter.
        ranges: (low, high) of parameters, where they are not the gait's own.
        by: what is to be great: "return", or a number in `info` such as "x_velocity".
        progress: called with the number of gaits tried, and that of all.

    Raises:
        InputError: no gait, no such parameter, or nothing of the name `by`.
    """
    if count < 2:
        raise InputError(f"a search tries at least 2 gaits, not {count}")
    bounds = _bounds(env_id, arguments, ranges or {})
    gaits = grid(bounds, count)
    values: list[float] = []
    for first in range(0, len(gaits), _AT_ONCE):
        some = gaits[first : first + _AT_ONCE]
        episodes = run_episodes(
            env_id,
            arguments,
            lambda env, some=some: make_gait(env_id, env, some),
            [SEED] * len(some),
        )
        values += [float(value) for value in _measured(episodes, by)]
        if progress is not None:
            progress(len(values), len(gaits))
    order = np.argsort(values)[::-1]
    found = tuple(Found(gaits[k], values[k]) for k in order)
    best = found[0].parameters
    edges = tuple(name for name, bound in bounds.items() if best[name] in bound)
    return Search(found, edges)


def grid(bounds: Mapping[str, tuple[float, float]], count: int) -> list[dict[str, float]]:
    """At least `count` points, the ends of all ranges included."""
    levels = max(2, math.ceil(round(count ** (1 / len(bounds)), 9)))
    axes = [np.linspace(low, high, levels).tolist() for low, high in bounds.values()]
    return [dict(zip(bounds, point, strict=True)) for point in itertools.product(*axes)]


def _bounds(
    env_id: str, arguments: Mapping[str, Any], ranges: Mapping[str, tuple[float, float]]
) -> dict[str, tuple[float, float]]:
    env = environments.one(env_id, arguments)
    try:
        task_of(env_id, env)
        gait = make_gait(env_id, env, {}).scripts[0].gait  # pyright: ignore[reportFunctionMemberAccess]
    finally:
        env.close()
    known = {**gait.bounds}
    names = [field.name for field in fields(gait)]
    for name, (low, high) in ranges.items():
        if name not in names:
            raise InputError(f"the gait of {env_id} has no {name!r}; it has: {', '.join(names)}")
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise InputError(f"the range of {name} must be from low to high, not {low:g}:{high:g}")
        known[name] = (low, high)
    return known


def _measured(episodes: Episodes, by: str) -> np.ndarray:
    if by == "return":
        return episodes.returns
    if by not in episodes.figures:
        raise InputError(
            f"the environment gives no {by!r} in its info; it gives: "
            f"{', '.join(sorted(episodes.figures))}"
        )
    return episodes.figures[by]
