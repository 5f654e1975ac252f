"""Pickles of models with sand in them, which bring mjgranular along.

MuJoCo looks a plugin up by its number, without asking whether anybody has registered it: a model
from a pickle ends a process that has not imported mjgranular. So a model with sand is pickled as a
call of a function of this module, which cannot be found without the import.
"""

from __future__ import annotations

import copyreg
from collections.abc import Callable
from typing import Any

import mujoco

from mjgranular.engine.instances import sands_in

PROTOCOL = 4  # of `__reduce_ex__`


def register() -> None:
    """Has `pickle`, and what is built on it, ask this module about MuJoCo's models and data."""
    copyreg.pickle(mujoco.MjModel, _reduce_model)
    copyreg.pickle(mujoco.MjData, _reduce_data)


def restore(make: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
    """Makes what was pickled, now that the plugins are registered."""
    return make(*arguments)


def _reduce_model(model: mujoco.MjModel) -> tuple[Any, ...]:
    return _reduce(model, model)


def _reduce_data(data: mujoco.MjData) -> tuple[Any, ...]:
    return _reduce(data, data.model)


def _reduce(one: Any, model: mujoco.MjModel) -> tuple[Any, ...]:
    make, arguments, *state = one.__reduce_ex__(PROTOCOL)
    if not sands_in(model):
        return make, arguments, *state
    return restore, (make, arguments), *state
