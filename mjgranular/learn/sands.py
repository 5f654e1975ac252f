"""The sand of an environment: recorded when a training starts, compared when the run is used.

Defaults may change with the next version, and a user's file at any time. Without a record a policy
would act on other sand than it was trained on, unnoticed.
"""

from __future__ import annotations

import math
import shlex
import warnings
from collections.abc import Iterable, Mapping
from contextlib import closing
from dataclasses import fields
from typing import Any

import mujoco

from mjgranular._util.io import fits, is_text
from mjgranular.engine.config import write_config
from mjgranular.engine.instances import material_in, sands_in
from mjgranular.errors import GranularError, GranularWarning, InputError, OutputError
from mjgranular.law import Law, laws
from mjgranular.learn import environments
from mjgranular.medium import Medium, media
from mjgranular.relief import Memory
from mjgranular.sand import Sand
from mjgranular.sand.spec import SandSpec
from mjgranular.surface import Surface

Sands = list[dict[str, Any]]
"""A table for each sand: names of `medium` and `law`, the law's `constants` by name, `surface` and
`memory` as in MJCF; `memory` is None for sand without memory."""

_TOLERANCE = 1e-6  # relative; chosen: far more than rounding, far less than a change
_LISTED = 4  # changes in a sentence; chosen
_MATERIAL = ("medium", "law", "constants")
_DETERMINED = {
    "medium": _MATERIAL,
    "law": _MATERIAL,
    "surface": ("surface",),
    "memory": ("memory",),
    "randomise": (*_MATERIAL, "surface"),
}
"""What an argument of an environment determines."""


def sands_of(env: Any) -> Sands | None:
    """Return the sands in the model of an environment, and of each `Sand` that is its attribute.

    The list is empty without sand; the result is None if the sand is unknown, for environments
    without a MuJoCo model as attribute `model`.
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
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GranularWarning)  # repeated when it is used
        env = environments.one(env_id, arguments)
    with closing(env):
        return sands_of(env)


def _record(medium: Medium, law: Law, surface: Surface, memory: Memory | None) -> dict[str, Any]:
    return {
        "medium": medium.name,
        "law": law.name,
        "constants": {name: getattr(law, name) for name in _constants(type(law))},
        "surface": _in_mjcf("surface", surface),
        "memory": None if memory is None else _in_mjcf("memory", memory),
    }


def _constants(law: type[Law]) -> list[str]:
    return [each.name for each in fields(law)]  # pyright: ignore[reportArgumentType]


def _in_mjcf(name: str, part: Any) -> str:
    """Return a surface or a memory as written in MJCF, a custom one by the name of its class."""
    try:
        return write_config(SandSpec(**{name: part}))[name]
    except InputError:
        return type(part).__name__


def read_sands(content: Any, where: object) -> Sands | None:
    """Check sands from a file; None if it has none.

    A constant that the law did not have when they were written is 0: it had no effect.

    Raises:
        OutputError: they do not have the form of `Sands`.
    """
    if content is None:
        return None
    if not isinstance(content, list) or not all(map(_is_record, content)):
        raise OutputError(
            f"{where}: sand must be a list of tables with medium, law, constants, surface, memory"
        )
    new = [_constants(laws[sand["law"]]) if sand["law"] in laws else () for sand in content]
    return [
        {**sand, "constants": {**dict.fromkeys(names, 0.0), **sand["constants"]}}
        for sand, names in zip(content, new, strict=True)
    ]


def _is_record(content: Any) -> bool:
    if not isinstance(content, dict) or not isinstance(content.get("constants"), dict):
        return False
    return (
        all(is_text(content.get(name)) for name in ("medium", "law", "surface"))
        and fits(content.get("memory"), str | None)
        and all(is_text(n) and fits(v, str | float | bool) for n, v in content["constants"].items())
    )


def changes(before: Sands, now: Sands, settled: Iterable[str] = ()) -> list[str]:
    """Return the differences between sands, such as "law rft3d (now rft3d_dynamic)".

    What the arguments named in `settled` determine is not compared: the user has set them.
    """
    ignored = {name for argument in settled for name in _DETERMINED.get(argument, ())}
    if len(before) != len(now):
        return [] if ignored else [f"{_names(before)} (now {_names(now)})"]
    found: dict[str, None] = {}
    for pair in zip(before, now, strict=True):
        one, other = (dict(sand) for sand in pair)
        constants = one.pop("constants"), other.pop("constants")
        same_law = (one["medium"], one["law"]) == (other["medium"], other["law"])
        if same_law and "constants" not in ignored:
            one, other = one | constants[0], other | constants[1]
        for name in one | other:
            was, value = one.get(name), other.get(name)
            if name not in ignored and not _is_same(was, value):
                found[f"{name} {_as_toml(was, 'g')} (now {_as_toml(value, 'g')})"] = None
    more = [f"{len(found) - _LISTED} more"] if len(found) > _LISTED else []
    return [*list(found)[:_LISTED], *more]


def _names(sands: Sands) -> str:
    names = [f"{sand['medium']} under the law {sand['law']}" for sand in sands]
    return " and ".join(dict.fromkeys(names)) or "no sand"


def _is_same(one: Any, other: Any) -> bool:
    if isinstance(one, (int, float)) and isinstance(other, (int, float)):
        return math.isclose(one, other, rel_tol=_TOLERANCE)
    return one == other


def arguments_for(sands: Sands, env_id: str, arguments: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return arguments in addition to the current ones that give an environment these sands.

    The result is None if none do.
    """
    if len(sands) != 1 or sands[0]["medium"] not in media or sands[0]["law"] not in laws:
        return None
    (sand,) = sands
    law, medium = {"law": sand["law"]}, {"medium": sand["medium"]}
    ground = {"surface": sand["surface"], "memory": sand["memory"] or False}
    constants = " ".join(f"{name}={_as_toml(value)}" for name, value in sand["constants"].items())
    with_constants = {"law": f"{sand['law']} {constants}"}
    for further in (law, medium | law, medium | law | ground, with_constants):
        try:
            now = sands_made(env_id, {**arguments, **further})
        except GranularError:  # it has no such argument
            continue
        if now is not None and not changes(sands, now):
            return further
    return None


def as_variant(arguments: Mapping[str, Any]) -> str:
    """Return arguments as `--on` takes them, quoted for a shell."""
    return shlex.quote(",".join(f"{name}={_as_toml(value)}" for name, value in arguments.items()))


def _as_toml(value: Any, form: str = "") -> str:
    if value is None or isinstance(value, bool):
        return str(value).lower()
    return f"{value:{form}}" if isinstance(value, float) else str(value)
