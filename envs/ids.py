"""The ids that `gymnasium.make` knows."""

from __future__ import annotations

import gymnasium as gym

from mjgranular.envs.chains import ChainCrawl, ChainSwim
from mjgranular.envs.gym_planar import HalfCheetah, Hopper, Swimmer, Walker2d
from mjgranular.envs.gym_spatial import Ant, Humanoid
from mjgranular.envs.hexapod import Hexapod
from mjgranular.envs.link_drop import LinkDrop
from mjgranular.envs.task import Task
from mjgranular.envs.tasks import tasks
from mjgranular.errors import InputError
from mjgranular.given import kind_of

NAMESPACE = "mjgranular"
VERSION = 0

DYNAMIC, DYNAMIC_LAW = "Dynamic", "rft3d_dynamic"
"""What is added to the names of tasks under a law for motion as fast as robots move, and the law.
Without it a task has its medium's law, which is quasi-static (docs/validity.md)."""

_OURS: tuple[type[Task], ...] = (
    ChainSwim,
    ChainCrawl,
    Hexapod,
    LinkDrop,
    Hopper,
    Walker2d,
    HalfCheetah,
    Ant,
    Humanoid,
    Swimmer,
)


def id_of(name: str) -> str:
    """The id of the task of that name."""
    return f"{NAMESPACE}/{name}-v{VERSION}"


def ids_of(name: str) -> list[str]:
    """The ids of the task of that name: its own, and that under the dynamic law."""
    return [one for one in (id_of(name), id_of(name + DYNAMIC)) if one in gym.registry]


def name_of(identity: str) -> str:
    """The task's name in an id; a name is taken as it is."""
    name = identity.removeprefix(f"{NAMESPACE}/").removesuffix(f"-v{VERSION}")
    return name if name in tasks else name.removesuffix(DYNAMIC)


def register_task(task: type[Task]) -> str:
    """Makes a task known by the name of its class: to `gymnasium.make` and to the command line.

    A class that is defined again, as in a cell of a notebook, takes the place of what it was.

    Args:
        task: a final task.

    Returns:
        Its id.

    Raises:
        InputError: it is no final task, or another has that name.
    """
    if not (isinstance(task, type) and issubclass(task, Task)):
        raise InputError(
            f"a task is a class that derives from mjgranular.envs.Task, not {kind_of(task)}"
        )
    missing = sorted(getattr(task, "__abstractmethods__", ()))
    if missing:
        raise InputError(f"the task {task.__name__} lacks {', '.join(missing)}")
    name = task.__name__
    before = tasks.get(name)
    again = before is not None and (before.__module__, before.__qualname__) == (
        task.__module__,
        task.__qualname__,
    )
    tasks.add(name, task, replace=again)
    return _register(id_of(name), task, {"task": name})


def _register(identity: str, task: type[Task], options: dict[str, str]) -> str:
    if identity not in gym.registry:
        gym.register(
            id=identity,
            entry_point="mjgranular.envs.single:SandEnv",
            vector_entry_point="mjgranular.envs.vector:SandVectorEnv",
            max_episode_steps=task.episode,
            kwargs=options,
        )
    return identity


def register() -> None:
    """Makes the package's tasks known; more than once does no harm."""
    for task in _OURS:
        register_task(task)
        if task is not LinkDrop:  # which has a law of its own, for one link
            name = task.__name__
            _register(id_of(name + DYNAMIC), task, {"task": name, "law": DYNAMIC_LAW})
