"""Evaluations of many agents on many kinds of ground, in blocks of episodes for workers.

The episodes of a block are stepped together. Results are bit-identical wherever a block runs.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mjgranular.errors import InputError
from mjgranular.learn.agents import Agent, make_baseline
from mjgranular.learn.evaluate import (
    AT_ONCE,
    FIRST_SEED,
    Episodes,
    Score,
    check_seeds,
    joined,
    parse_variant,
    run_episodes,
)
from mjgranular.learn.policies import Policy
from mjgranular.pool import Journal, Mapped, Workers, map_tasks


@dataclass(frozen=True)
class Actor:
    """Agent and environment; can be sent to other processes.

    Attributes:
        name: display name.
        environment: Gymnasium's id.
        arguments: arguments of the environment.
        agent: a policy, or the name of a baseline.
        gait: parameters of the baseline `gait` that differ from its defaults.
    """

    name: str
    environment: str
    arguments: Mapping[str, Any]
    agent: Policy | str
    gait: Mapping[str, float] | None = None

    def make(self, env: Any) -> Agent:
        """Return the agent for an environment, or for several."""
        if isinstance(self.agent, str):
            return make_baseline(self.agent, self.environment, env, gait=self.gait)
        return self.agent.checked(self.environment, env)

    def config(self) -> dict[str, Any]:
        """Return what determines its episodes, in plain values."""
        agent = self.agent if isinstance(self.agent, str) else _digest(self.agent)
        return {**vars(self), "arguments": dict(self.arguments), "agent": agent}


class Job(NamedTuple):
    """An agent on a variant of its environment, `name=value,...`; "" for none."""

    actor: Actor
    variant: str = ""


class _Block(NamedTuple):
    """Episodes of one job that are stepped together."""

    job: int
    seeds: range


@dataclass(frozen=True)
class Evaluation:
    """One episode of each job for each of consecutive seeds."""

    jobs: Sequence[Job]
    seeds: int = 10
    first_seed: int = FIRST_SEED

    def __post_init__(self) -> None:
        check_seeds(self.seeds, self.first_seed)

    def blocks(self) -> list[_Block]:
        """Return the episodes, job by job."""
        seeds = range(self.first_seed, self.first_seed + self.seeds)
        return [
            _Block(job, seeds[first : first + AT_ONCE])
            for job in range(len(self.jobs))
            for first in range(0, self.seeds, AT_ONCE)
        ]

    def journal(self, folder: Path | None) -> Journal:
        """Return the journal of episodes in a folder; None for a temporary file."""
        asked = {
            "jobs": [{**job.actor.config(), "variant": job.variant} for job in self.jobs],
            "seeds": self.seeds,
            "first_seed": self.first_seed,
        }
        return Journal(folder, asked, len(self.blocks()), _is_block)


def run_evaluation(
    evaluation: Evaluation,
    *,
    on: Workers | None = None,
    journal: Journal | None = None,
    progress: Callable[[int], None] | None = None,
) -> list[Score] | Mapped:
    """Run all episodes. The results do not depend on where they run.

    Args:
        evaluation: the episodes.
        on: pool that steps blocks of episodes; None for this process, on all cores.
        journal: `evaluation.journal`, opened; None for a temporary one.
        progress: called with the number of blocks that are done.

    Returns:
        A score for each job; after an interruption what is finished.

    Raises:
        InputError: a job cannot be run.
    """
    on = on or Workers(count=1)
    jobs, blocks = evaluation.jobs, evaluation.blocks()
    if journal is None:
        journal = evaluation.journal(None)
        journal.begin()
    threads = None if on.engine == "local" and on.count == 1 else 1
    shared = (tuple(jobs), threads)
    found = map_tasks(_run_block, blocks, shared=shared, on=on, journal=journal, progress=progress)
    if found.interrupted:
        return found
    for failure in found.failures:
        name = jobs[blocks[failure.index].job].actor.name
        raise InputError(failure.reason if len(jobs) == 1 else f"{name}: {failure.reason}")
    parts: list[list[Episodes]] = [[] for _ in jobs]
    for block, row in zip(blocks, journal.results(), strict=True):
        parts[block.job].append(_episodes(block.seeds, row))
    return [
        Score(actor.name, actor.environment, variant, joined(some))
        for (actor, variant), some in zip(jobs, parts, strict=True)
    ]


def _run_block(shared: tuple[Sequence[Job], int | None], block: _Block) -> dict[str, Any]:
    """Return the episodes of one block as plain values, in any process."""
    jobs, threads = shared
    actor, variant = jobs[block.job]
    arguments = {**actor.arguments, **parse_variant(variant)}
    found = run_episodes(actor.environment, arguments, actor.make, block.seeds, threads=threads)
    return {
        "returns": _plain(found.returns),
        "lengths": found.lengths.tolist(),
        "figures": {name: _plain(values) for name, values in found.figures.items()},
    }


def _plain(values: np.ndarray) -> list[str]:
    # As strings, which read back the same: JSON has no infinity.
    return [repr(float(value)) for value in values]


def _episodes(seeds: range, row: Mapping[str, Any]) -> Episodes:
    return Episodes(
        np.array(seeds),
        np.array([float(value) for value in row["returns"]]),
        np.array(row["lengths"], dtype=np.int64),
        {name: np.array([float(v) for v in values]) for name, values in row["figures"].items()},
    )


def _is_block(row: Mapping[str, Any]) -> bool:
    try:
        count = len(row["returns"])
        found = _episodes(range(count), row)
    except (KeyError, TypeError, ValueError, OverflowError, AttributeError):
        return False
    arrays = [found.returns, found.lengths, *found.figures.values()]
    return all(array.shape == (count,) for array in arrays)


def _digest(policy: Policy) -> str:
    """Return a hash of all weights: more training gives another."""
    digest = hashlib.sha256()
    for name, value in policy.model.state_dict().items():
        digest.update(name.encode() + value.numpy().tobytes())
    digest.update(policy.normalizer.mean.tobytes() + policy.normalizer.variance.tobytes())
    return digest.hexdigest()
