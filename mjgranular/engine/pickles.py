"""Pickles of models with sand, which import mjgranular when they are loaded.

MuJoCo looks up a plugin by its index without checking that it is registered: a model from a pickle
would end a process that has not imported mjgranular. So a model with sand is pickled as a call of a
function of this module, which cannot be found without the import.
"""

import copyreg
from collections.abc import Callable
from typing import Any

import mujoco

from mjgranular.engine.instances import sands_in

PROTOCOL = 4  # of `__reduce_ex__`


def register() -> None:
    """Have `pickle`, and what is built on it, use this module for MuJoCo's models and data."""
    copyreg.pickle(mujoco.MjModel, lambda model: _reduce(model, model))
    copyreg.pickle(mujoco.MjData, lambda data: _reduce(data, data.model))


def restore(make: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
    """Restore what was pickled, after the plugins are registered."""
    return make(*arguments)


def _reduce(one: Any, model: mujoco.MjModel) -> tuple[Any, ...]:
    make, arguments, *state = one.__reduce_ex__(PROTOCOL)
    if not sands_in(model):
        return make, arguments, *state
    return restore, (make, arguments), *state
