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
from mjgranular.cli.agents import Actor, find_actor, warn_of_sand
from mjgranular.cli.console import out, print_json, progress_bar
from mjgranular.cli.results import Flag, OutputOptions
from mjgranular.errors import InputError
from mjgranular.learn import environments
from mjgranular.learn.evaluate import FIRST_SEED, Score, check_seeds, evaluate, parse_variant
from mjgranular.learn.sands import sands_of


@dataclass(frozen=True, kw_only=True)
class EvaluateCommand(OutputOptions):
    """Mean return over seeds with its 95 % confidence interval, for policies and baselines.

    Each POLICY is the folder of a run, the name of a policy that comes with the package
    (`mjgranular list policies`), or with --agent zero, random or gait the id of an environment.
    --on adds other sands: every policy is run in its own environment and in each of the variants.
    """

    policies: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="POLICY ...")]
    """Runs, policies, or environments for --agent."""
    agent: Annotated[str, tyro.conf.arg(metavar="policy|zero|random|gait")] = "policy"
    """The agent."""
    gait: Annotated[str, tyro.conf.arg(metavar="NAME=VALUE,...")] = ""
    """Parameters for --agent gait."""
    env: Annotated[str | None, tyro.conf.arg(metavar="ENV")] = None
    """Another environment with the same observations and actions as in training."""
    on: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE,... ...")] = ()
    """Variants of the environment, for example medium=glass_beads."""
    seeds: Annotated[int, tyro.conf.arg(metavar="N")] = 10
    """Number of episodes, one per seed."""
    first_seed: Annotated[int, tyro.conf.arg(metavar="N")] = FIRST_SEED
    """The first of consecutive seeds."""
    trust: Flag = False
    """Import and so execute the module of an environment that only a run's file names."""

    def run(self) -> int:
        """Run the command."""
        jobs = self._jobs()
        with self.claimed(CONFIG, SUMMARY) as folder:
            scores = []
            with progress_bar("running episodes", len(jobs)) as show:
                for done, (actor, variant) in enumerate(jobs):
                    show(done, f"{actor.name} {variant}")
                    scores.append(self._score(actor, variant))
            rows = [score.as_json() for score in scores]
            if folder is not None:
                names = ("policies", "agent", "env", "on", "seeds", "first_seed")
                config = {name: getattr(self, name) for name in names}
                with folder.published("evaluate", config, rows):
                    pass  # there are no other files
            if self.json:
                print_json(rows)
            else:
                out.print(table_of(scores, self.seeds))
        return self.finish()

    def _score(self, actor: Actor, variant: str) -> Score:
        return evaluate(
            actor.name,
            actor.make,
            actor.environment,
            actor.arguments,
            variant=variant,
            seeds=self.seeds,
            first_seed=self.first_seed,
        )

    def _jobs(self) -> list[tuple[Actor, str]]:
        """Return the agents and variants, after making each environment once to find mistakes."""
        if not self.policies:
            raise InputError("evaluate needs a run, a policy or, with --agent, an environment")
        if self.gait and self.agent != "gait":
            raise InputError("--gait is for --agent gait")
        check_seeds(self.seeds, self.first_seed)
        gait = parse_variant(self.gait)
        actors = [
            find_actor(what, agent=self.agent, environment=self.env, gait=gait, trust=self.trust)
            for what in self.policies
        ]
        jobs = [(actor, variant) for actor in actors for variant in dict.fromkeys(("", *self.on))]
        for actor, variant in jobs:
            arguments = {**actor.arguments, **parse_variant(variant)}
            with closing(environments.one(actor.environment, arguments)) as env:
                if not variant:
                    warn_of_sand(actor, sands_of(env))
        return jobs


def table_of(scores: list[Score], seeds: int) -> Table:
    """Return a table of scores, without columns that have one value in all rows."""
    environments = {score.environment for score in scores}
    where = f" in {environments.pop()}" if len(environments) == 1 else ""
    columns: dict[str, Callable[[Score], str]] = {"agent": lambda score: score.agent}
    if not where:
        columns["environment"] = lambda score: score.environment.rpartition("/")[2]
    if any(score.variant for score in scores):
        columns["on"] = lambda score: score.variant or "its own"
    words = len(columns)
    columns["return"] = lambda score: str(score.returned)
    columns["steps"] = lambda score: f"{score.length.mean:.0f}"
    if any("x_velocity" in score.episodes.figures for score in scores):
        columns["speed [m/s]"] = lambda score: str(score.figure("x_velocity") or "")
    if any("sand/valid" in score.episodes.figures for score in scores):
        columns["law held"] = _share_valid
    title = f"Mean of {seeds} seeds ± half the 95 % interval{where}"
    table = Table(title=title, title_justify="left")
    for number, heading in enumerate(columns):
        justify = "left" if number < words else "right"
        no_wrap = justify == "right"
        table.add_column(Text(heading), justify=justify, no_wrap=no_wrap, overflow="fold")
    for score in scores:
        table.add_row(*(cell(score) for cell in columns.values()))
    return table


def _share_valid(score: Score) -> str:
    valid = score.figure("sand/valid")
    return "" if valid is None else f"{valid.mean:.0%}"
