"""`mjgranular evaluate`: returns of agents over many seeds; agents named on the command line."""

from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.table import Table

from mjgranular._util.checks import check_name, require
from mjgranular.cli.console import out, print_result, progress_bar, table
from mjgranular.cli.options import Flag
from mjgranular.errors import InputError, OutputError, UnknownNameError
from mjgranular.learn import environments
from mjgranular.learn.evaluate import (
    BASELINES,
    FIRST_SEED,
    Agent,
    Score,
    check_seeds,
    evaluate,
    make_baseline,
    parse_variant,
)
from mjgranular.learn.policies import Policy, load_policy
from mjgranular.learn.sands import Sands, sands_made, sands_of


@dataclass(frozen=True)
class Actor:
    """Agent and environment, by the id and with the arguments of Gymnasium."""

    name: str
    environment: str
    arguments: Mapping[str, Any]
    agent: Policy | str  # a policy, or the name of a baseline
    gait: Mapping[str, float] | None = None  # parameters that differ from the defaults

    def make(self, env: Any) -> Agent:
        if isinstance(self.agent, str):
            return make_baseline(self.agent, self.environment, env, gait=self.gait)
        return self.agent.checked(self.environment, env)

    def arguments_on(self, variant: str) -> dict[str, Any]:
        """Return the arguments of a variant; without one, warn of sand unlike that of training."""
        arguments = {**self.arguments, **parse_variant(variant)}
        if not variant:
            warn_of_sand(self, sands_made(self.environment, arguments))
        return arguments


@dataclass(frozen=True)
class EvaluateCommand:
    """Mean return over seeds with its 95 % confidence interval, for policies and baselines.

    Each POLICY is the folder of a run, the name of a policy that comes with the package
    (`mjgranular list policies`), or with --agent zero, random or gait the id of an environment.
    --on adds other sands: every policy is run in its own environment and in each of the variants;
    with --env in the variants of that one alone.
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
    json: Flag = False
    """Print JSON instead of a table."""

    def run(self) -> int:
        jobs, seeds = self._jobs(), {"seeds": self.seeds, "first_seed": self.first_seed}
        scores = []
        with progress_bar("running episodes", len(jobs)) as show:
            for done, (actor, variant) in enumerate(jobs):
                show(done, f"{actor.name} {variant}")
                what = actor.name, actor.make, actor.environment, actor.arguments
                scores.append(evaluate(*what, variant=variant, **seeds))
        content = [score.as_json() for score in scores]
        print_result(content, lambda: out.print(table_of(scores, self.seeds)), json=self.json)
        return 0

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
        variants = dict.fromkeys(self.on if self.env and self.on else ("", *self.on))
        jobs = [(actor, variant) for actor in actors for variant in variants]
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
        columns["law held"] = lambda s: f"{v.mean:.0%}" if (v := s.figure("sand/valid")) else ""
    title = f"Mean of {seeds} seeds ± half the 95 % interval{where}"
    rows = ([cell(score) for cell in columns.values()] for score in scores)
    return table(title, columns, rows, words=words, fold=True)


def find_actor(
    what: str,
    *,
    agent: str = "policy",
    environment: str | None = None,
    gait: Mapping[str, float] | None = None,
    trust: bool = False,
) -> Actor:
    """Return the agent that a word on the command line names, and its environment.

    The word is a run's folder, a policy's, or for `BASELINES` an environment's id. `trust` allows
    to import a module that only the run's file names.
    """
    check_name("agent", agent, ("policy", *BASELINES))
    if agent != "policy":
        if environment is not None:
            raise InputError(f"--env is for policies; --agent {agent} acts in the one named first")
        environments.find_spec(what)
        return Actor(agent, what, {}, agent, gait)
    try:
        policy = load_policy(what)
    except UnknownNameError as error:
        if not is_environment(what):
            raise
        raise InputError(
            f"{what} is an environment: choose its agent with --agent {'|'.join(BASELINES)}, or "
            "name a run or policy"
        ) from error
    # Networks of this size are faster on one thread; the cores step environments.
    require("torch", extra="train", purpose="Running a policy").set_num_threads(1)
    run = replace(policy.run, trusted=trust)
    if environment is None:  # otherwise the user names it
        run.check_environment()
    env_id = environment or run.environment
    arguments = dict(run.settings.environment) if env_id == run.environment else {}
    return Actor(what, env_id, arguments, policy)


def warn_of_sand(actor: Actor, now: Sands | None) -> None:
    """Warn if a policy is not on the sand on which it was trained, unless the user asked so."""
    if isinstance(actor.agent, Policy) and actor.environment == actor.agent.run.environment:
        actor.agent.run.warn_of_sand(now)


def is_environment(what: str) -> bool:
    """Return True if a word is the id of an environment, and not a folder."""
    if Path(what).exists():
        return False
    try:
        environments.find_spec(what)
    except (UnknownNameError, OutputError):
        if ":" in what:  # no run has such a name
            raise
        return False
    return True
