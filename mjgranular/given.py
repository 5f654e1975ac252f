"""What a user hands over in another's place: a sentence that says what was meant to be there."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco

from mjgranular.errors import InputError, shown
from mjgranular.surface import Plane, Surface


def check_model(model: Any, who: str) -> None:
    """Refuses what is no compiled model.

    Raises:
        InputError: says how one is made of it.
    """
    if isinstance(model, mujoco.MjModel):
        return
    if isinstance(model, (str, Path)):
        meant = f"mujoco.MjModel.from_xml_path({str(model)!r})"
    elif isinstance(model, mujoco.MjSpec):
        meant = "spec.compile(), or mjgranular.add_sand for the MjSpec itself"
    elif isinstance(model, mujoco.MjData):
        meant = "data.model"
    else:
        meant = "mujoco.MjModel.from_xml_path(...)"
    raise InputError(f"{who} takes a compiled mujoco.MjModel, not {_kind(model)}; use {meant}")


def check_spec(spec: Any, who: str) -> None:
    """Refuses what is no `MjSpec`.

    Raises:
        InputError: says how one is made of it.
    """
    if isinstance(spec, mujoco.MjSpec):
        return
    meant = "mujoco.MjSpec.from_file(...)"
    if isinstance(spec, (str, Path)):
        meant = f"mujoco.MjSpec.from_file({str(spec)!r})"
    elif isinstance(spec, mujoco.MjModel):
        meant = "mjgranular.Sand for a model that is compiled"
    raise InputError(f"{who} takes a mujoco.MjSpec, not {_kind(spec)}; use {meant}")


def check_data(data: Any, who: str) -> None:
    """Refuses what is no `MjData`.

    Raises:
        InputError: says how one is made.
    """
    if not isinstance(data, mujoco.MjData):
        raise InputError(
            f"{who} takes a mujoco.MjData, not {_kind(data)}; use mujoco.MjData(model)"
        )


def surface_of(surface: Any) -> Surface:
    """A surface, the plane z = 0 for None.

    Raises:
        InputError: it is something else; says what a number or a name may have meant.
    """
    if surface is None:
        return Plane()
    if isinstance(surface, Surface):
        return surface
    meant = "Plane(height=...), Bed('geom') or HeightField('geom')"
    if isinstance(surface, (int, float)):
        meant = f"Plane(height={surface:g}) for a level surface at that height"
    elif isinstance(surface, str):
        meant = f"Bed({shown(surface)}) or HeightField({shown(surface)}) for a geom of that name"
    raise InputError(f"a surface is needed, not {_kind(surface)}; use {meant}")


def _kind(value: Any) -> str:
    """What something is, in a word or two."""
    if isinstance(value, type):
        return f"the class {value.__name__}"
    if value is None or isinstance(value, (str, int, float)):
        return shown(value)
    return f"a {type(value).__name__}"
