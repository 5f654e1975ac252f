"""Ids of environments: those of the package for `gymnasium.make`, and all that Gymnasium knows."""

import difflib
from typing import Any

import gymnasium as gym
from gymnasium.envs.registration import EnvSpec, load_env_creator

from mjgranular._util.checks import kind_of
from mjgranular._util.user_modules import import_own
from mjgranular.envs.chains import ChainCrawl, ChainSwim
from mjgranular.envs.gym_robots import Ant, HalfCheetah, Hopper, Humanoid, Swimmer, Walker2d
from mjgranular.envs.hexapod import Hexapod
from mjgranular.envs.link_drop import LinkDrop
from mjgranular.envs.task import Task, tasks
from mjgranular.envs.velocity import G1Velocity, Go1Velocity, Go2Velocity
from mjgranular.errors import InputError, UnknownNameError

NAMESPACE = "mjgranular"
VERSION = 0

_OURS: tuple[type[Task], ...] = (
    ChainSwim, ChainCrawl, Hexapod, LinkDrop,
    Hopper, Walker2d, HalfCheetah, Ant, Humanoid, Swimmer,
    Go1Velocity, Go2Velocity, G1Velocity,
)  # fmt: skip


def id_of(name: str) -> str:
    """Return the id of a task from its name."""
    return f"{NAMESPACE}/{name}-v{VERSION}"


def name_of(identity: str) -> str:
    """Return the task's name from an id; a name is returned unchanged."""
    return identity.removeprefix(f"{NAMESPACE}/").removesuffix(f"-v{VERSION}")


def register_task(task: type[Task]) -> str:
    """Register a task by the name of its class, for `gymnasium.make` and the command line.

    A class that is defined again, as in a cell of a notebook, replaces the old one. Return the id.

    Raises:
        InputError: it is not a final task, or another task has that name.
    """
    if not (isinstance(task, type) and issubclass(task, Task)):
        raise InputError(
            f"a task is a class that derives from mjgranular.envs.Task, not {kind_of(task)}"
        )
    missing = sorted(getattr(task, "__abstractmethods__", ()))
    if missing:
        raise InputError(f"the task {task.__name__} lacks {', '.join(missing)}")
    name = task.__name__
    tasks.add(name, task)
    identity = id_of(name)
    gym.registry.pop(identity, None)  # an old one may have another time limit
    gym.register(
        id=identity,
        entry_point="mjgranular.envs.single:SandEnv",
        vector_entry_point="mjgranular.envs.vector:SandVectorEnv",
        max_episode_steps=task.episode,
        kwargs={"task": name},
    )
    return identity


for _task in _OURS:
    register_task(_task)


def find_spec(env_id: Any) -> EnvSpec:
    """Return Gymnasium's specification of an environment, from its id.

    `my_module:My-v0` imports the module that registers it, also from the current folder
    (`mjgranular._util.user_modules`). Errors list ids of mjgranular and similar ones.
    """
    if not isinstance(env_id, str):
        raise InputError(f"an environment is named by a string such as 'Ant-v5', not {env_id!r}")
    module, colon, name = env_id.rpartition(":")
    hint = "one of your own is named with its module, my_module:My-v0"
    if colon:
        if not name:
            raise InputError(f"{env_id!r} lacks the id behind the colon: {module}:My-v0, say")
        import_own(module, f"the environment {env_id}")
        hint = f"importing {module} has registered no {name}"
    try:
        return gym.spec(name)
    except gym.error.Error:
        known = sorted(gym.registry)
        ours = [one for one in known if one.startswith("mjgranular/")]
        others = [one for one in known if one not in ours]
        near = difflib.get_close_matches(name, others, n=5, cutoff=0.5)
        raise UnknownNameError("environment", env_id, [*near, *ours], hint) from None


def creator_of(entry_point: Any) -> Any:
    """Return the class of an environment, or the function that makes it."""
    return load_env_creator(entry_point) if isinstance(entry_point, str) else entry_point
