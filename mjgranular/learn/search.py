"""The best of the scripted gaits of an environment, from a grid over their parameters."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from mjgranular.errors import InputError
from mjgranular.learn import environments
from mjgranular.learn.agents import make_gait, task_of
from mjgranular.learn.episodes import AT_ONCE, Episodes, run_episodes
from mjgranular.pool import Journal, Mapped, Workers, map_tasks

SEED = 20_000
"""Of the search's episodes; others than those of an evaluation, lest the best be the luckiest."""


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
    on: Workers | None = None,
    journal: Journal | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Search | Mapped:
    """Tries a grid of at least `count` gaits, each for one episode from the same start.

    Numbers are the same wherever that is: gaits are tried in blocks, which workers take.

    Args:
        env_id: of an environment that has a scripted gait.
        arguments: of the environment.
        count: how many gaits at least; as many values of each parameter.
        ranges: (low, high) of parameters, where they are not the gait's own.
        by: what is to be great: "return", or a number in `info` such as "x_velocity".
        on: where; None for this process, on all cores.
        journal: `journal_of` the search, begun; None for one that is gone with the result.
        progress: called with the number of gaits tried, and that of all.

    Returns:
        What was found; where it was interrupted, what was done until then.

    Raises:
        InputError: no gait, no such parameter, or nothing of the name `by`.
    """
    bounds = _bounds(env_id, arguments, ranges or {}, count)
    gaits = grid(bounds, count)
    on = on or Workers(count=1)
    blocks = _blocks(gaits)
    alone = on.engine == "local" and on.count == 1

    def told(done: int) -> None:
        if progress is not None:
            progress(min(done * AT_ONCE, len(gaits)), len(gaits))

    found = map_tasks(
        _run_block,
        blocks,
        shared=(env_id, dict(arguments), by, None if alone else 1),
        on=on,
        journal=journal,
        progress=told,
    )
    if found.interrupted:
        return found
    if found.failures:
        raise InputError(found.failures[0].reason)
    values = [float(value) for row in found.journal.results() for value in row["values"]]
    order = np.argsort(values)[::-1]
    tried = tuple(Found(gaits[k], values[k]) for k in order)
    best = tried[0].parameters
    edges = tuple(name for name, bound in bounds.items() if best[name] in bound)
    return Search(tried, edges)


def journal_of(
    folder: Path | None,
    env_id: str,
    arguments: Mapping[str, Any],
    *,
    count: int,
    ranges: Mapping[str, tuple[float, float]],
    by: str,
) -> Journal:
    """The values of a search that a folder keeps; None for a file that is soon gone."""
    bounds = _bounds(env_id, arguments, ranges, count)
    asked = {
        "environment": env_id,
        "arguments": dict(arguments),
        "bounds": bounds,
        "search": count,
        "by": by,
    }
    return Journal(folder, asked, len(_blocks(grid(bounds, count))), _is_block)


def _blocks(gaits: Sequence[dict[str, float]]) -> list[Sequence[dict[str, float]]]:
    return [gaits[first : first + AT_ONCE] for first in range(0, len(gaits), AT_ONCE)]


def _run_block(
    shared: tuple[str, dict[str, Any], str, int | None], gaits: Sequence[dict[str, float]]
) -> dict[str, Any]:
    """What was asked for of each gait, in whatever process."""
    env_id, arguments, by, threads = shared
    episodes = run_episodes(
        env_id,
        arguments,
        lambda env: make_gait(env_id, env, gaits),
        [SEED] * len(gaits),
        threads=threads,
    )
    # As texts, which read back the same: JSON has no infinity.
    return {"values": [repr(float(value)) for value in _measured(episodes, by)]}


def _is_block(row: Mapping[str, Any]) -> bool:
    try:
        return bool([float(value) for value in row["values"]])
    except (KeyError, TypeError, ValueError):
        return False


def grid(bounds: Mapping[str, tuple[float, float]], count: int) -> list[dict[str, float]]:
    """At least `count` points, the ends of all ranges included."""
    levels = max(2, math.ceil(round(count ** (1 / len(bounds)), 9)))
    axes = [np.linspace(low, high, levels).tolist() for low, high in bounds.values()]
    return [dict(zip(bounds, point, strict=True)) for point in itertools.product(*axes)]


def _bounds(
    env_id: str,
    arguments: Mapping[str, Any],
    ranges: Mapping[str, tuple[float, float]],
    count: int,
) -> dict[str, tuple[float, float]]:
    if count < 2:
        raise InputError(f"a search tries at least 2 gaits, not {count}")
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
