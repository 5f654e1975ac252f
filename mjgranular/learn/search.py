"""Search for the best scripted gait of an environment, on a grid over its parameters."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from mjgranular.errors import InputError
from mjgranular.learn import environments
from mjgranular.learn.agents import make_gait
from mjgranular.learn.episodes import AT_ONCE, run_episodes

SEED = 20_000
"""Seed of the search's episodes; evaluations use others."""


@dataclass(frozen=True)
class Search:
    """Result of a search.

    Attributes:
        gaits: parameters and value of each gait, the best first.
        edges: parameters whose best value is an end of its range: widen the range.
    """

    gaits: tuple[tuple[dict[str, float], float], ...]
    edges: tuple[str, ...]


def search_gaits(
    env_id: str,
    arguments: Mapping[str, Any] | None = None,
    *,
    count: int = 200,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    by: str = "return",
) -> Search:
    """Try a grid of at least `count` gaits, each for one episode from the same start.

    Args:
        env_id: Gymnasium id of an environment with a scripted gait.
        arguments: arguments of the environment.
        count: least number of gaits; each parameter takes the same number of values.
        ranges: (low, high) of parameters that differ from the gait's own ranges.
        by: value to maximize: "return", or a number in `info` such as "x_velocity".

    Raises:
        InputError: no gait, no such parameter, or no number of the name `by`.
    """
    arguments = arguments or {}
    if count < 2:
        raise InputError(f"a search tries at least 2 gaits, not {count}")
    env = environments.one(env_id, arguments)
    try:
        gait: Any = make_gait(env_id, env, {}).scripts[0]
    finally:
        env.close()
    bounds, names = {**gait.gait.bounds}, [field.name for field in fields(gait.gait)]
    for name, (low, high) in (ranges or {}).items():
        if name not in names:
            raise InputError(f"the gait of {env_id} has no {name!r}; it has: {', '.join(names)}")
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise InputError(f"the range of {name} must be from low to high, got {low:g}:{high:g}")
        bounds[name] = (low, high)
    gaits = grid(bounds, count)
    values: list[float] = []
    for some in (gaits[first : first + AT_ONCE] for first in range(0, len(gaits), AT_ONCE)):
        episodes = run_episodes(
            env_id,
            arguments,
            lambda env, some=some: make_gait(env_id, env, some),
            [SEED] * len(some),
        )
        found = {"return": episodes.returns, **episodes.figures}
        if by not in found:
            raise InputError(
                f"the environment has no {by!r} in its info; it has: "
                f"{', '.join(sorted(episodes.figures))}"
            )
        values += found[by].tolist()
    tried = tuple((gaits[k], values[k]) for k in np.argsort(values)[::-1])
    return Search(tried, tuple(name for name, ends in bounds.items() if tried[0][0][name] in ends))


def grid(bounds: Mapping[str, tuple[float, float]], count: int) -> list[dict[str, float]]:
    """Return at least `count` points, the ends of all ranges included."""
    levels = max(2, math.ceil(round(count ** (1 / len(bounds)), 9)))
    axes = [np.linspace(low, high, levels).tolist() for low, high in bounds.values()]
    return [dict(zip(bounds, point, strict=True)) for point in itertools.product(*axes)]
