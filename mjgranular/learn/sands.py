"""What the sand of an environment is: noted where a training begins, compared wherever it is used.

What an environment leaves to defaults may be another with the next version, a file of the user's
own with the next day. A policy would then act on other sand than it was trained on, and nothing
would say so.
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

from mjgranular.engine.config import write_config
from mjgranular.engine.instances import material_in, sands_in
from mjgranular.errors import GranularError, GranularWarning, InputError, OutputError
from mjgranular.law import Law, laws
from mjgranular.learn import environments
from mjgranular.medium import Medium, media
from mjgranular.relief import Memory
from mjgranular.sand import Sand
from mjgranular.sand.spec import SandSpec
from mjgranular.saved import is_text
from mjgranular.surface import Surface

Sands = list[dict[str, Any]]
"""One for each sand: names of `medium` and `law`, the law's `constants` by name, `surface` and
`memory` in words; None for sand without memory."""

_SAME = 1e-6  # relative; chosen: far more than rounding, far less than a change
_SHOWN = 3  # constants in a sentence
_MATERIAL = ("medium", "law", "constants")
# What a user has settled himself who names an argument.
_SETTLED = {
    "medium": _MATERIAL,
    "law": _MATERIAL,
    "surface": ("surface",),
    "memory": ("memory",),
    "randomise": (*_MATERIAL, "surface"),
}


def sands_of(env: Any) -> Sands | None:
    """The sands of an environment: those in its model, and each `Sand` that is its attribute.

    Args:
        env: a `gymnasium.Env`.

    Returns:
        Plain values, empty where there is no sand; None where the environment has no attribute
        `model` of MuJoCo's, by which that could be known.
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
    """The sands that an environment has when it is made; see `sands_of`.

    Raises:
        GranularError: it cannot be made.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GranularWarning)  # given where it is made to be used
        env = environments.one(env_id, arguments)
    with closing(env):
        return sands_of(env)


def read_sands(content: Any, where: object) -> Sands | None:
    """Return sands from a file; None if it has none noted.

    A constant that a law did not have when they were noted is 0: it had no effect.

    Raises:
        OutputError: they are not as `Sands` says.
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


def told(sands: Sands) -> str:
    """Sands in words, by medium and law."""
    named = [f"{sand['medium']} under the law {sand['law']}" for sand in sands]
    return " and ".join(dict.fromkeys(named)) or "no sand"


def changes(before: Sands, now: Sands, settled: Iterable[str] = ()) -> list[str]:
    """What differs between sands, in words: "law rft3d (now rft3d_dynamic)".

    Args:
        before: the one.
        now: the other.
        settled: names of arguments that the user has given himself, and what follows from them.
    """
    known = {name for argument in settled for name in _SETTLED.get(argument, ())}
    if len(before) != len(now):
        return [] if known else [f"{told(before)} (now {told(now)})"]
    found = []
    for was, here in zip(before, now, strict=True):
        differing = [
            name
            for name in ("medium", "law", "surface", "memory")
            if was[name] != here[name] and name not in known
        ]
        found += [
            f"{name} {was[name] or 'none'} (now {here[name] or 'none'})" for name in differing
        ]
        if "constants" not in known and all(was[name] == here[name] for name in ("medium", "law")):
            found += _other_constants(was, here)
    return list(dict.fromkeys(found))


def arguments_for(sands: Sands, env_id: str, arguments: Mapping[str, Any]) -> dict[str, Any] | None:
    """Further arguments with which an environment has such sands; None where none are found.

    Args:
        sands: what it is to have.
        env_id: the environment.
        arguments: of it, with which it has others.
    """
    if len(sands) != 1 or sands[0]["medium"] not in media or sands[0]["law"] not in laws:
        return None
    (sand,) = sands
    constants = " ".join(f"{name}={_word(value)}" for name, value in sand["constants"].items())
    memory = {"memory": sand["memory"] or False}
    for given in (
        {"law": sand["law"]},
        {"medium": sand["medium"], "law": sand["law"]},
        {"medium": sand["medium"], "law": sand["law"], "surface": sand["surface"], **memory},
        {"law": f"{sand['law']} {constants}"},
    ):
        try:
            now = sands_made(env_id, {**arguments, **given})
        except GranularError:  # it takes no such argument
            continue
        if now is not None and not changes(sands, now):
            return given
    return None


def as_variant(arguments: Mapping[str, Any]) -> str:
    """Arguments as `--on` takes them, in a shell."""
    words = ",".join(
        f"{name}={_word(value) if isinstance(value, bool) else value}"
        for name, value in arguments.items()
    )
    return shlex.quote(words)


def _plain(medium: Medium, law: Law, surface: Surface, memory: Memory | None) -> dict[str, Any]:
    names = [field.name for field in fields(law)]  # pyright: ignore[reportArgumentType]
    return {
        "medium": medium.name,
        "law": law.name,
        "constants": {name: getattr(law, name) for name in names},
        "surface": _in_words("surface", surface),
        "memory": None if memory is None else _in_words("memory", memory),
    }


def _in_words(name: str, part: Any) -> str:
    """A surface or a memory as MJCF has it; one of somebody's own by the name of its class."""
    try:
        return write_config(SandSpec(**{name: part}))[name]
    except InputError:
        return type(part).__name__


def _other_constants(was: Mapping[str, Any], here: Mapping[str, Any]) -> list[str]:
    one, other = was["constants"], here["constants"]
    found = [
        f"{name} {_shown(one.get(name))} (now {_shown(other.get(name))})"
        for name in {**one, **other}
        if not _same(one.get(name), other.get(name))
    ]
    more = [f"{len(found) - _SHOWN} more constants"] if len(found) > _SHOWN else []
    return [*found[:_SHOWN], *more]


def _same(one: Any, other: Any) -> bool:
    if _is_number(one) and _is_number(other):
        return math.isclose(one, other, rel_tol=_SAME)
    return one == other


def _shown(value: Any) -> str:
    return "none" if value is None else f"{value:g}" if _is_number(value) else _word(value)


def _word(value: Any) -> str:
    return ("true" if value else "false") if isinstance(value, bool) else str(value)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _is_sand(content: Any) -> bool:
    if not isinstance(content, dict):
        return False
    constants, memory = content.get("constants"), content.get("memory")
    return (
        all(is_text(content.get(name)) for name in ("medium", "law", "surface"))
        and (memory is None or is_text(memory))
        and isinstance(constants, dict)
        and all(
            is_text(name) and (isinstance(value, bool) or is_text(value) or _is_finite(value))
            for name, value in constants.items()
        )
    )


def _is_finite(value: Any) -> bool:
    return _is_number(value) and abs(value) < 1e300
