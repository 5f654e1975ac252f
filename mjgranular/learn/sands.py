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

from mjgranular._util.io import is_text
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

_SAME = 1e-6  # relative; chosen: far more than rounding, far less than a change
_SHOWN = 4  # changes in a sentence; chosen
# What a given argument determines.
_MATERIAL = ("medium", "law", "constants")
_SETTLED = {
    "medium": _MATERIAL,
    "law": _MATERIAL,
    "surface": ("surface",),
    "memory": ("memory",),
    "randomise": (*_MATERIAL, "surface"),
}


def sands_of(env: Any) -> Sands | None:
    """Return the sands in the model of an environment, and of each `Sand` that is its attribute.

    Args:
        env: a `gymnasium.Env`.

    Returns:
        Plain values, empty without sand; None if unknown, where the environment has no MuJoCo model
        as attribute `model`.
    """
    inner = env.unwrapped
    model = getattr(inner, "model", None)
    if not isinstance(model, mujoco.MjModel):
        return None
    held = [each for each in vars(inner).values() if isinstance(each, Sand)]
    return [
        *(_plain(*material_in(model, name)) for name in sands_in(model)),
        *(_plain(sand.medium, sand.law, sand.surface, sand.memory) for sand in held),
    ]


def sands_made(env_id: str, arguments: Mapping[str, Any]) -> Sands | None:
    """Make an environment and return its sands, as `sands_of` does.

    Raises:
        GranularError: it cannot be made.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GranularWarning)  # given again when it is used
        env = environments.one(env_id, arguments)
    with closing(env):
        return sands_of(env)


def read_sands(content: Any, where: object) -> Sands | None:
    """Check sands from a file; None if it has none.

    A constant that a law did not have when they were written is 0: it had no effect.

    Raises:
        OutputError: they do not have the form of `Sands`.
    """
    if content is None:
        return None
    if not isinstance(content, list) or not all(map(_is_sand, content)):
        raise OutputError(
            f"{where}: sand must be a list of tables with medium, law, constants, surface, memory"
        )
    return [_with_new_constants(sand) for sand in content]


def _with_new_constants(sand: dict[str, Any]) -> dict[str, Any]:
    law = laws.get(sand["law"])
    new = {} if law is None else {field.name: 0.0 for field in fields(law)}  # pyright: ignore[reportArgumentType]
    return {**sand, "constants": {**new, **sand["constants"]}}


def changes(before: Sands, now: Sands, settled: Iterable[str] = ()) -> list[str]:
    """Return what differs between sands: "law rft3d (now rft3d_dynamic)".

    Args:
        before: sands of a run.
        now: sands of an environment.
        settled: names of arguments that the user has given; what follows from them is not counted.
    """
    known = {name for argument in settled for name in _SETTLED.get(argument, ())}
    if len(before) != len(now):
        return [] if known else [f"{_names(before)} (now {_names(now)})"]
    found: dict[str, None] = {}
    for was, here in zip(before, now, strict=True):
        one, other = (dict(sand) for sand in (was, here))
        constants = one.pop("constants"), other.pop("constants")
        if (was["medium"], was["law"]) == (
            here["medium"],
            here["law"],
        ) and "constants" not in known:
            one, other = one | constants[0], other | constants[1]
        for name in one | other:
            values = one.get(name), other.get(name)
            if name not in known and not _is_same(*values):
                found[f"{name} {_word(values[0], 'g')} (now {_word(values[1], 'g')})"] = None
    more = [f"{len(found) - _SHOWN} more"] if len(found) > _SHOWN else []
    return [*list(found)[:_SHOWN], *more]


def arguments_for(sands: Sands, env_id: str, arguments: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return further arguments that give an environment these sands; None if none do.

    Args:
        sands: the wanted sands.
        env_id: Gymnasium id.
        arguments: current arguments, with which it has other sands.
    """
    if len(sands) != 1 or sands[0]["medium"] not in media or sands[0]["law"] not in laws:
        return None
    (sand,) = sands
    law, medium = {"law": sand["law"]}, {"medium": sand["medium"]}
    ground = {"surface": sand["surface"], "memory": sand["memory"] or False}
    constants = " ".join(f"{name}={_word(value)}" for name, value in sand["constants"].items())
    in_full = {"law": f"{sand['law']} {constants}"}
    for given in (law, medium | law, medium | law | ground, in_full):
        try:
            now = sands_made(env_id, {**arguments, **given})
        except GranularError:  # it takes no such argument
            continue
        if now is not None and not changes(sands, now):
            return given
    return None


def as_variant(arguments: Mapping[str, Any]) -> str:
    """Return arguments as `--on` takes them, quoted for a shell."""
    return shlex.quote(",".join(f"{name}={_word(value)}" for name, value in arguments.items()))


def _plain(medium: Medium, law: Law, surface: Surface, memory: Memory | None) -> dict[str, Any]:
    every: Any = fields(law)  # pyright: ignore[reportArgumentType]
    return {
        "medium": medium.name,
        "law": law.name,
        "constants": {field.name: getattr(law, field.name) for field in every},
        "surface": _in_mjcf("surface", surface),
        "memory": None if memory is None else _in_mjcf("memory", memory),
    }


def _in_mjcf(name: str, part: Any) -> str:
    """Return a surface or a memory as written in MJCF, a custom one by the name of its class."""
    try:
        return write_config(SandSpec(**{name: part}))[name]
    except InputError:
        return type(part).__name__


def _names(sands: Sands) -> str:
    named = [f"{sand['medium']} under the law {sand['law']}" for sand in sands]
    return " and ".join(dict.fromkeys(named)) or "no sand"


def _is_same(one: Any, other: Any) -> bool:
    if isinstance(one, (int, float)) and isinstance(other, (int, float)):
        return math.isclose(one, other, rel_tol=_SAME)
    return one == other


def _word(value: Any, form: str = "") -> str:
    if value is None or isinstance(value, bool):
        return str(value).lower()
    return f"{value:{form}}" if isinstance(value, float) else str(value)


def _is_sand(content: Any) -> bool:
    if not isinstance(content, dict) or not isinstance(content.get("constants"), dict):
        return False
    texts = [content.get(name) for name in ("medium", "law", "surface")]
    texts += [*content["constants"], content.get("memory") or "none"]
    return all(map(is_text, texts)) and all(
        is_text(value) or (isinstance(value, (int, float)) and abs(value) < 1e300)
        for value in content["constants"].values()
    )
