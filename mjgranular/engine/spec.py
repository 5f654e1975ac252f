"""Sand written into an `MjSpec`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import mujoco

from mjgranular.engine.config import DEFAULT_MEDIUM, write_config
from mjgranular.engine.instances import NAME
from mjgranular.engine.plugin import check_registered
from mjgranular.errors import InputError
from mjgranular.given import check_spec, surface_of
from mjgranular.law import Law
from mjgranular.medium import Medium
from mjgranular.scheme.scheme import SchemeChoice
from mjgranular.shape.select import Choice
from mjgranular.surface import Surface


def add_sand(
    spec: mujoco.MjSpec,
    *,
    medium: str | Path | Medium = DEFAULT_MEDIUM,
    law: str | Law | None = None,
    surface: Surface | None = None,
    scheme: str | SchemeChoice = "auto",
    bodies: Choice = None,
    geoms: Choice = None,
    groups: Sequence[int] | int | None = None,
    resolution: int | None = None,
    draw: Sequence[str] | str = (),
    tunable: bool = False,
    name: str | None = None,
) -> mujoco.MjsPlugin:
    """Adds sand to a model: from then on it acts inside `mj_step`.

    What is added is an instance of the plugin `mjgranular.sand`, which stays through XML. Called
    twice, it adds two: two media in two beds, for example.

    Args:
        spec: the model to be.
        medium: as for `Sand`; one that is known by its name, or a YAML file.
        law: as for `Sand`.
        surface: as for `Sand`.
        scheme: as for `Sand`.
        bodies: as for `Sand`.
        geoms: as for `Sand`.
        groups: as for `Sand`.
        resolution: as for `Sand`.
        draw: what viewers and renderers are to show: "forces", "depth".
        tunable: let each simulation have its own strength, density and height of the sand, as a
            part of MuJoCo's state (`tune`).
        name: of the instance; None for "sand", "sand_2", ...

    Returns:
        The instance.

    Raises:
        InputError: an object that has no name to be written by, or a name that is taken. What does
            not fit the model is found when it is compiled.
        LayoutError: this version of MuJoCo cannot be used with the plugin.
    """
    check_spec(spec, "add_sand")
    check_registered()
    config = write_config(
        {
            "medium": medium,
            "law": law,
            "surface": None if surface is None else surface_of(surface),
            "scheme": scheme,
            "bodies": bodies,
            "geoms": geoms,
            "groups": groups,
            "resolution": resolution,
            "draw": draw,
            "tunable": tunable,
        }
    )
    taken = {plugin.name for plugin in spec.plugins}
    if name is None:
        name = next(free for free in _names() if free not in taken)
    elif name in taken:
        raise InputError(f"the model has a plugin instance named {name!r} already")
    spec.activate_plugin(NAME)
    instance = spec.add_plugin(name=name, plugin_name=NAME, active=True)
    instance.config = config
    _attach(spec, name)
    return instance


def _names() -> Iterator[str]:
    yield "sand"
    number = 2
    while True:
        yield f"sand_{number}"
        number += 1


def _attach(spec: mujoco.MjSpec, name: str) -> None:
    """Has a body refer to the instance.

    It means nothing to the physics. But `MjSpec.copy` and `MjSpec.attach` drop instances that
    nothing refers to, without a word. A body can refer to one.
    """
    for body in spec.bodies[1:]:
        if not body.plugin.active:
            body.plugin.active = True
            body.plugin.plugin_name = NAME
            body.plugin.name = name
            return
