"""Agents named on the command line, for `mjgranular evaluate` and `mjgranular render`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from mjgranular._util.extras import require
from mjgranular.errors import InputError, OutputError, UnknownNameError, warn_user
from mjgranular.learn import environments
from mjgranular.learn.agents import BASELINES
from mjgranular.learn.blocks import Actor
from mjgranular.learn.evaluate import parse_variant
from mjgranular.learn.policies import Policy, load_policy
from mjgranular.learn.sands import Sands, arguments_for, as_variant


def find_actor(
    what: str,
    *,
    agent: str = "policy",
    environment: str | None = None,
    gait: Mapping[str, float] | None = None,
    trust: bool = False,
) -> Actor:
    """Return the agent that a word on the command line names, and its environment.

    Args:
        what: a run's folder, a policy's, or an environment's id for agents that need no training.
        agent: policy, or one of `BASELINES`.
        environment: another environment than the one in which the policy was trained.
        gait: parameters of the gait that differ from its defaults.
        trust: whether a module that only the run's file names may be imported.
    """
    if agent not in ("policy", *BASELINES):
        raise UnknownNameError("agent", agent, ("policy", *BASELINES))
    if agent != "policy":
        return _find_baseline(what, agent, environment, gait, trust)
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


def _find_baseline(
    what: str,
    agent: str,
    environment: str | None,
    gait: Mapping[str, float] | None,
    trust: bool,
) -> Actor:
    if environment is not None:
        raise InputError(f"--env is for policies; --agent {agent} acts in the one named first")
    if is_environment(what):
        return Actor(agent, what, {}, agent, gait)
    try:
        run = replace(load_policy(what).run, trusted=trust)
    except UnknownNameError:
        environments.find_spec(what)  # lists environments
        raise
    run.check_environment()
    warn_user(
        f"{agent} acts in the environment of {what}, whose policy is not used; omit --agent to use "
        "the policy"
    )
    return Actor(agent, run.environment, dict(run.settings.environment), agent, gait)


def sand_warning(actor: Actor, variant: str, now: Sands | None) -> str | None:
    """Return a warning if a policy is not on the sand on which it was trained, otherwise None.

    Args:
        actor: the agent.
        variant: `name=value,...`, changes of the environment's arguments, which the user wants.
        now: the sand of the environment, with the variant; None if unknown.
    """
    run = actor.agent.run if isinstance(actor.agent, Policy) else None
    if run is None or run.sand is None or actor.environment != run.environment:
        return None
    wanted = parse_variant(variant)
    other = run.other_sand(now, wanted)
    if other is None:
        return None
    restored = arguments_for(run.sand, run.environment, {**actor.arguments, **wanted})
    if restored is None:
        return f"{actor.name} {other}; its environment cannot have that sand any more"
    return f"{actor.name} {other}; --on {as_variant(restored)} restores it"


def is_environment(what: str) -> bool:
    """Return True if a word is the id of an environment, and not a folder.

    Raises:
        GranularError: the module before a colon cannot be imported, or registers no such id.
    """
    if Path(what).exists():
        return False
    try:
        environments.find_spec(what)
    except (UnknownNameError, OutputError):
        if ":" in what:  # no run has such a name
            raise
        return False
    return True
