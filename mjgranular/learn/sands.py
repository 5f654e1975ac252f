"""The sand of an environment: recorded when a training starts, compared when the run is used.

Defaults may change with the next version, and a user's file at any time. Without a record a policy
would act on other sand than it was trained on, unnoticed.
"""

import warnings
from collections.abc import Mapping
from contextlib import closing
from dataclasses import fields
from typing import Any

import mujoco

from mjgranular.engine.config import write_config
from mjgranular.engine.instances import material_in, sands_in
from mjgranular.errors import GranularError, GranularWarning
from mjgranular.law import Law
from mjgranular.learn import environments
from mjgranular.medium import Medium
from mjgranular.relief import Memory
from mjgranular.sand import Sand
from mjgranular.sand.spec import SandSpec
from mjgranular.surface import Surface

Sands = list[dict[str, Any]]
"""A table for each sand: names of `medium` and `law`, the law's `constants` by name, `surface` and
`memory` as in MJCF; `memory` is None for sand without memory."""


def sands_of(env: Any) -> Sands | None:
    """Return the sands in the model of an environment, and of each `Sand` that is its attribute.

    The result is None if the sand is unknown: the environment has no MuJoCo model as `model`.
    """
    inner = env.unwrapped
    model = getattr(inner, "model", None)
    if not isinstance(model, mujoco.MjModel):
        return None
    attributes = [each for each in vars(inner).values() if isinstance(each, Sand)]
    return [
        *(_record(*material_in(model, name)) for name in sands_in(model)),
        *(_record(sand.medium, sand.law, sand.surface, sand.memory) for sand in attributes),
    ]


def sands_made(env_id: str, arguments: Mapping[str, Any]) -> Sands | None:
    """Make an environment and return its sands, as `sands_of` does."""
    with warnings.catch_warnings(action="ignore", category=GranularWarning):  # repeated when used
        env = environments.one(env_id, arguments)
    with closing(env):
        return sands_of(env)


def _record(medium: Medium, law: Law, surface: Surface, memory: Memory | None) -> dict[str, Any]:
    every: Any = fields(law)  # pyright: ignore[reportArgumentType]
    return {
        "medium": medium.name,
        "law": law.name,
        "constants": {each.name: getattr(law, each.name) for each in every},
        "surface": _in_mjcf("surface", surface),
        "memory": None if memory is None else _in_mjcf("memory", memory),
    }


def _in_mjcf(name: str, part: Any) -> str:
    """Return a surface or a memory as written in MJCF, a custom one by the name of its class."""
    try:
        return write_config(SandSpec(**{name: part}))[name]
    except GranularError:
        return type(part).__name__


def is_sands(content: Any) -> bool:
    """Return True if a value from a file has the form of `Sands`."""
    needed = {"medium", "law", "constants", "surface", "memory"}
    return isinstance(content, list) and all(
        isinstance(sand, dict) and needed <= sand.keys() and isinstance(sand["constants"], dict)
        for sand in content
    )


def changes(before: Sands | None, now: Sands | None) -> str:
    """Return the differences between sands, such as "law rft3d (now rft3d_dynamic)".

    The result is empty if nothing differs or a sand is unknown.
    """
    if before is None or now is None:
        return ""
    if len(before) != len(now):
        return f"{len(before)} sands (now {len(now)})"
    found: dict[str, None] = {}
    for pair in zip(before, now, strict=True):
        (one, constants), (other, others) = map(_in_words, pair)
        if (one["medium"], one["law"]) == (other["medium"], other["law"]):
            one, other = one | constants, other | others
        for name in one | other:
            # A constant that the law did not have once is 0: it had no effect.
            was, value = one.get(name, "0"), other.get(name, "0")
            if was != value:
                found[f"{name} {was} (now {value})"] = None
    return ", ".join(found)


def _in_words(sand: Mapping[str, Any]) -> tuple[dict[str, str], dict[str, str]]:
    """Return a sand and its constants with values as strings, numbers with six digits."""
    words = {name: "no" if sand[name] is None else str(sand[name]) for name in sand}
    del words["constants"]
    return words, {
        name: f"{value:g}" if isinstance(value, float) else str(value)
        for name, value in sand["constants"].items()
    }
