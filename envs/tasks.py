"""Tasks by name."""

from dataclasses import fields
from typing import Any

from mjgranular._util.registry import Registry
from mjgranular.envs.task import Task
from mjgranular.errors import InputError

tasks: Registry[type[Task]] = Registry("environment")
"""Tasks by the names in their ids: `ChainSwim` for `mjgranular/ChainSwim-v0`."""


def get_task(task: str | Task, options: dict[str, Any]) -> Task:
    """Return a task from its name and its options."""
    if isinstance(task, Task):
        if options:
            raise InputError(f"a task has its options already: {', '.join(options)}")
        return task
    cls = tasks[task]
    known = [item.name for item in fields(cls)]
    for name in options:
        if name not in known:
            raise InputError(f"{task} has no option {name!r}; it has: {', '.join(known)}")
    return cls(**options)
