"""Options that `mjgranular evaluate` and `mjgranular render` share: agent and environment."""

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
from mjgranular.learn.run import Run
from mjgranular.learn.sands import Sands, arguments_for, as_variant


def find_actor(
    what: str,
    *,
    agent: str = "policy",
    environment: str | None = None,
    gait: Mapping[str, float] | None = None,
    trust: bool = False,
) -> Actor:
    """Finds the agent that a word on the command line means.

    Args:
        what: a run's folder, a policy's, or an environment's id for agents that need no training.
        agent: policy, or one of `BASELINES`.
        environment: another than the one that the policy was trained in.
        gait: parameters of the gait, where they differ from its own.
        trust: whether a module that only the run's file names may be imported.
    """
    if agent not in ("policy", *BASELINES):
        raise UnknownNameError("agent", agent, ("policy", *BASELINES))
    if agent == "policy":
        try:
            policy = load_policy(what)
            # Networks of this size are quicker on one thread; the cores step environments.
            require("torch", extra="train", purpose="Running a policy").set_num_threads(1)
            return _policy(what, policy, environment, trust)
        except UnknownNameError as error:
            if not is_environment(what):
                raise
            raise InputError(
                f"{what} is an environment: say who acts in it, with --agent "
                f"{'|'.join(BASELINES)}, or name a run or policy"
            ) from error
    if environment is not None:
        raise InputError(f"--env is for policies; --agent {agent} acts in the one named first")
    env_id, arguments = what, {}
    if not is_environment(what):
        run = replace(_run_of(what), trusted=trust)
        run.check_environment()
        env_id, arguments = run.environment, dict(run.settings.environment)
        warn_user(
            f"{agent} acts in the environment of {what}, whose policy is left alone: without "
            "--agent it is the policy that acts"
        )
    return Actor(agent, env_id, arguments, agent, gait)


def doubt_of(actor: Actor, variant: str, now: Sands | None) -> str | None:
    """A sentence on a policy that is not on the sand that it was trained on; None if it is.

    Args:
        actor: who acts.
        variant: `name=value,...`, changes of the environment's arguments: what the user has asked
            for in it goes without a word.
        now: the sand of the environment, with the variant; None where it is not known.
    """
    run = actor.who.run if isinstance(actor.who, Policy) else None
    if run is None or run.sand is None or actor.environment != run.environment:
        return None
    changes = parse_variant(variant)
    other = run.other_sand(now, changes)
    if other is None:
        return None
    restored = arguments_for(run.sand, run.environment, {**actor.arguments, **changes})
    if restored is None:
        return f"{actor.name} {other}; its environment cannot be given that any more"
    return f"{actor.name} {other}; --on {as_variant(restored)} gives it what it was begun on"


def _policy(what: str, policy: Policy, environment: str | None, trust: bool) -> Actor:
    run = replace(policy.run, trusted=trust)
    if environment is None:  # else the user names it himself
        run.check_environment()
    env_id = environment or run.environment
    same = env_id == run.environment
    arguments = dict(run.settings.environment) if same else {}
    environments.find_spec(env_id)
    return Actor(what, env_id, arguments, policy)


def _run_of(what: str) -> Run:
    """Return the run in whose environment a baseline acts, or an error about the environment."""
    try:
        return load_policy(what).run
    except UnknownNameError:
        environments.find_spec(what)
        raise


def is_environment(what: str) -> bool:
    """Return whether a word is the id of an environment, and not a folder.

    Raises:
        GranularError: the module before a colon cannot be imported, or registers no such id.
    """
    if Path(what).exists():
        return False
    if ":" in what:  # no run has such a name
        environments.find_spec(what)
        return True
    try:
        environments.find_spec(what)
    except (UnknownNameError, OutputError):
        return False
    return True
