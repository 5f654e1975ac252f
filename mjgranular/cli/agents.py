"""Agents named on the command line, for `mjgranular evaluate` and `mjgranular render`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mjgranular._util.extras import require
from mjgranular.errors import InputError, OutputError, UnknownNameError
from mjgranular.learn import environments
from mjgranular.learn.agents import BASELINES, Agent, make_baseline
from mjgranular.learn.policies import Policy, load_policy
from mjgranular.learn.sands import Sands


@dataclass(frozen=True)
class Actor:
    """Agent and environment, by the id and with the arguments of Gymnasium."""

    name: str
    environment: str
    arguments: Mapping[str, Any]
    agent: Policy | str  # a policy, or the name of a baseline
    gait: Mapping[str, float] | None = None  # parameters that differ from the defaults

    def make(self, env: Any) -> Agent:
        """Return the agent for an environment, or for several."""
        if isinstance(self.agent, str):
            return make_baseline(self.agent, self.environment, env, gait=self.gait)
        return self.agent.checked(self.environment, env)


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
    if agent not in ("policy", *BASELINES):
        raise UnknownNameError("agent", agent, ("policy", *BASELINES))
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
    environments.find_spec(env_id)
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
