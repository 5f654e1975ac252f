"""Sand that each simulation can tune: its state, and what that changes.

A tunable instance has four numbers in `mjData.plugin_state`: whether it is active, two factors on
its resistance, and how far its surface is raised. They are part of MuJoCo's state: saved, restored,
copied and batched with it. They change a list of numbers in the record that kernels read of law and
surface, made from each law's own description of its fields; `adjust` applies it.
"""

from typing import Any

import mujoco
import numpy as np

from mjgranular._util.checks import check_kind, kind_of
from mjgranular.engine.instances import instance_of
from mjgranular.errors import InputError, shown
from mjgranular.sand.prepare import PreparedSand

STATE = ("active", "strength", "density", "height")
"""The numbers of a tunable instance, in their order in `plugin_state`."""

ACTIVE, STRENGTH, DENSITY, HEIGHT = range(len(STATE))
STATE_SIZE = len(STATE)

INITIAL = (1.0, 1.0, 1.0, 0.0)
"""Values after a reset."""

TUNING_DTYPE = np.dtype(
    [
        ("word", np.int64),  # of the scene
        ("number", np.int64),  # of the state: STRENGTH, DENSITY or HEIGHT
        ("base", np.float64),  # its value in the state INITIAL
        ("rate", np.float64),  # its change per meter of height
    ]
)
NO_TUNINGS = np.zeros(0, TUNING_DTYPE)


def make_tunings(sand: PreparedSand, model: mujoco.MjModel) -> np.ndarray:
    """Make the list of what the state changes in a scene: rows of `TUNING_DTYPE`."""
    law, scene = sand.law, sand.scene
    if not (law.strength_keys or law.density_keys):
        raise InputError(
            f"the law {law.name!r} cannot be tuned: it must have strength_keys or density_keys"
        )
    rows: list[tuple[int, int, float, float]] = []
    for number, keys in ((STRENGTH, law.strength_keys), (DENSITY, law.density_keys)):
        for key in keys:
            rows += [(word, number, base, 0.0) for word, base in _words(scene, "law", key)]
    for key, rates in sand.surface.lift(model).items():
        words = _words(scene, "surface", key)
        for (word, base), rate in zip(words, np.ravel(rates), strict=True):
            rows.append((word, HEIGHT, base, float(rate)))
    return np.array(rows, TUNING_DTYPE)


def _words(scene: np.ndarray, part: str, key: str) -> list[tuple[int, float]]:
    """Return the indices of a field's numbers in the scene [words of 8 bytes], and the numbers."""
    fields: Any = scene.dtype.fields
    inner: Any = fields[part][0].fields
    first = (fields[part][1] + inner[key][1]) // 8
    return [(first + i, float(value)) for i, value in enumerate(np.ravel(scene[part][key]))]


def tune(
    model: mujoco.MjModel,
    state: np.ndarray,
    name: str,
    *,
    active: Any = None,
    strength: Any = None,
    density: Any = None,
    height: Any = None,
) -> None:
    """Set the state of a tunable sand, made with `tunable="true"`; omitted values are unchanged.

    Args:
        model: the model.
        state: `data.plugin_state`, or a row or all rows of `batch.bind("plugin_state")`, shape
            (..., npluginstate); written to. Other values may be arrays of shape (...).
        name: name of the instance.
        active: whether the sand is active.
        strength: factor on static resistance.
        density: factor on resistance by velocity.
        height: height of the surface above its original place, along its normal [m].

    Raises:
        UnknownNameError: the model has no such sand; lists those it has.
        InputError: it is not tunable, `state` does not fit the model, or a value is not a number,
            negative or not finite. Then nothing is written.
    """
    check_kind(model, mujoco.MjModel, "tune")
    if not isinstance(state, np.ndarray):
        meant = "; use data.plugin_state" if isinstance(state, mujoco.MjData) else ""
        raise InputError(
            "tune writes to an array, data.plugin_state or batch.bind('plugin_state'), not to "
            f"{kind_of(state)}{meant}"
        )
    instance = instance_of(model, name)
    if model.plugin_statenum[instance] != STATE_SIZE:
        raise InputError(
            f"the sand {name!r} is not tunable: make it with add_sand(..., tunable=True) or "
            '<config key="tunable" value="true"/>'
        )
    if state.ndim == 0 or state.shape[-1] != model.npluginstate:
        raise InputError(
            f"the state must have {model.npluginstate} numbers, as plugin_state of this model, "
            f"not the shape {state.shape}"
        )
    values = zip(STATE, (active, strength, density, height), strict=True)
    rows = state.shape[:-1]
    given = {key: _number(key, value, rows) for key, value in values if value is not None}
    first = int(model.plugin_stateadr[instance])
    for key, value in given.items():
        state[..., first + STATE.index(key)] = value


def _number(key: str, value: Any, rows: tuple[int, ...]) -> np.ndarray:
    """Return a value of the state as an array that fits its rows."""
    array = np.asarray(value)
    if array.dtype.kind not in "biuf":  # a string of digits would be read as a number
        raise InputError(f"{key} must be a number, or one for each simulation, not {shown(value)}")
    array = array.astype(float)
    if not np.isfinite(array).all() or (key != "height" and (array < 0).any()):
        kind = "finite" if key == "height" else "finite and not negative"
        raise InputError(f"{key} must be {kind}, not {array}")
    if key == "active" and not ((array == 0) | (array == 1)).all():
        raise InputError(f"active must be 0 or 1, False or True, not {array}")
    if array.size != 1 and array.shape != rows[len(rows) - array.ndim :]:
        raise InputError(
            f"{key} must be one number, or one for each simulation, shape {rows}, not of shape "
            f"{array.shape}"
        )
    return array if array.size != 1 else array.reshape(())
