"""`mjgranular evaluate`: returns of agents over many seeds, on several sands."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from typing import Annotated

import tyro
from rich.table import Table
from rich.text import Text

from mjgranular._util.result_folder import CONFIG, SUMMARY
from mjgranular.cli.agents import doubt_of, find_actor
from mjgranular.cli.console import out, print_json, progress_bar
from mjgranular.cli.engines import EngineOptions
from mjgranular.errors import InputError, warn_user
from mjgranular.learn import environments
from mjgranular.learn.blocks import Evaluation, Job, run_evaluation
from mjgranular.learn.evaluate import FIRST_SEED, Score, check_seeds, parse_variant
from mjgranular.learn.sands import sands_of
from mjgranular.pool import Journal, Mapped, Workers

_SPEED = "x_velocity"
_VALID = "sand/valid"


@dataclass(frozen=True, kw_only=True)
class EvaluateCommand(EngineOptions):
    """Mean return over seeds with its 95 % confidence interval, for policies and baselines.

    Each POLICY is the folder of a run, the name of a policy that comes with the package
    (`mjgranular list policies`), or with --agent zero, random or gait the id of an environment.
    --on adds other sands: every policy is run in its own environment and in each of the variants.
    Workers take 64 episodes of one of these at a time; the numbers are the same to the last bit.
    """

    policies: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="POLICY ...")]
    """Runs, policies, or environments for --agent."""
    agent: Annotated[str, tyro.conf.arg(metavar="policy|zero|random|gait")] = "policy"
    """Who acts."""
    gait: Annotated[str, tyro.conf.arg(metavar="NAME=VALUE,...")] = ""
    """Parameters for --agent gait."""
    env: Annotated[str | None, tyro.conf.arg(metavar="ENV")] = None
    """Another environment than the one trained in; must observe and move the same."""
    on: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE,... ...")] = ()
    """Variants of the environment, for example medium=glass_beads."""
    seeds: Annotated[int, tyro.conf.arg(metavar="N")] = 10
    """Episodes, one a seed."""
    first_seed: Annotated[int, tyro.conf.arg(metavar="N")] = FIRST_SEED
    """The first seed; the others follow it."""
    trust: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Import the module of an environment that only a run's file names: this executes it."""

    @property
    def where(self) -> Workers:
        """Where episodes are run: by default in this process, where a batch uses all cores."""
        count = 1 if self.engine == "local" and self.workers is None else self.workers
        return Workers(self.engine, count, self.chunk, self.address)

    def run(self) -> int:
        """Runs the command."""
        if not self.policies:
            raise InputError("evaluate needs a run, a policy or, with --agent, an environment")
        check_seeds(self.seeds)
        for variant in self.on:
            parse_variant(variant)
        if self.gait and self.agent != "gait":
            raise InputError("--gait is for --agent gait")
        _ = self.where  # which checks itself
        self.check_resume()
        evaluation = self._evaluation()
        journal = evaluation.journal(self.out)
        with self.resumable(journal, CONFIG, SUMMARY) as folder:
            scores = self._scores(evaluation, journal)
            if isinstance(scores, Mapped):
                return self.show_interrupted(journal, scores.stopped_by)
            if folder is not None:
                asked = {
                    "policies": list(self.policies),
                    "agent": self.agent,
                    "environment": self.env,
                    "variants": list(self.on),
                    "seeds": self.seeds,
                    "first_seed": self.first_seed,
                }
                with folder.published():
                    folder.write_config("evaluate", asked)
                    folder.write_json(SUMMARY, [score.as_json() for score in scores])
            self._show(scores)
        return self.finish()

    def _evaluation(self) -> Evaluation:
        actors = [
            find_actor(
                what,
                agent=self.agent,
                environment=self.env,
                gait=parse_variant(self.gait),
                trust=self.trust,
            )
            for what in self.policies
        ]
        jobs = [Job(actor, variant) for actor in actors for variant in ("", *self.on)]
        doubts = []
        for actor, variant in jobs:  # a mistake in one is reported before the others run
            given = {**actor.arguments, **parse_variant(variant)}
            with closing(environments.one(actor.environment, given)) as env:
                doubts.append(doubt_of(actor, variant, sands_of(env)))
        for doubt in dict.fromkeys(filter(None, doubts)):
            warn_user(doubt)
        return Evaluation(jobs, self.seeds, self.first_seed)

    def _scores(self, evaluation: Evaluation, journal: Journal) -> list[Score] | Mapped:
        with progress_bar("running episodes", len(evaluation.jobs) * self.seeds) as show:
            return run_evaluation(evaluation, on=self.where, journal=journal, progress=show)

    def _show(self, scores: list[Score]) -> None:
        if self.json:
            print_json([score.as_json() for score in scores])
        else:
            out.print(table_of(scores, self.seeds))


def table_of(scores: list[Score], seeds: int) -> Table:
    """Scores for people; columns with one value in all rows are omitted."""
    environments = {score.environment for score in scores}
    where = f" in {environments.pop()}" if len(environments) == 1 else ""
    columns: list[tuple[str, Callable[[Score], str]]] = [("agent", lambda score: score.agent)]
    if not where:
        columns.append(("environment", lambda score: score.environment.rpartition("/")[2]))
    if any(score.variant for score in scores):
        columns.append(("on", lambda score: score.variant or "its own"))
    words = len(columns)
    columns.append(("return", lambda score: str(score.returned)))
    columns.append(("steps", lambda score: f"{score.length.mean:.0f}"))
    if any(score.figure(_SPEED) is not None for score in scores):
        columns.append(("speed [m/s]", lambda score: str(score.figure(_SPEED) or "")))
    if any(score.figure(_VALID) is not None for score in scores):
        columns.append(("law held", _held))
    title = f"Mean of {seeds} seeds ± half the 95 % interval{where}"
    table = Table(title=title, title_justify="left")
    for number, (heading, _) in enumerate(columns):
        left = number < words
        table.add_column(
            Text(heading), justify="left" if left else "right", no_wrap=not left, overflow="fold"
        )
    for score in scores:
        table.add_row(*(cell(score) for _, cell in columns))
    return table


def _held(score: Score) -> str:
    valid = score.figure(_VALID)
    return "" if valid is None else f"{valid.mean:.0%}"
