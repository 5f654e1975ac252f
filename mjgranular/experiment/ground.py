"""A user's model and the ground that it brings along."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco

from mjgranular.errors import InputError, UnknownNameError
from mjgranular.shape import select_geoms
from mjgranular.surface import Surface
from mjgranular.surface.floors import describe_floors, find_floors


def take_out(spec: mujoco.MjSpec, geoms: Sequence[str]) -> None:
    """Takes geoms out of a model, such as a floor that sand is to take the place of.

    Args:
        spec: the model to be; it is changed.
        geoms: names, or numbers of geoms without a name.

    Raises:
        UnknownNameError: there is no such geom; lists those there are.
    """
    if any(spec.geom(name) is None and name.isdecimal() for name in geoms):
        spec.compile()  # gives geoms their numbers
    numbered = {str(geom.id): geom for geom in spec.geoms if not geom.name}
    found = {name: spec.geom(name) or numbered.get(name) for name in geoms}
    for name, geom in found.items():
        if geom is None:
            known = [geom.name for geom in spec.geoms if geom.name]
            raise UnknownNameError("geom of the model", name, known)
    for geom in found.values():
        spec.delete(geom)


def refuse_floors(
    model: mujoco.MjModel,
    surface: Surface,
    *,
    bodies: Sequence[str],
    geoms: Sequence[str],
    groups: Sequence[int],
) -> None:
    """Refuses a model whose own ground carries it at or above the sand's surface.

    Args:
        model: the model.
        surface: where the sand is.
        bodies: as for `Sand`, none for all.
        geoms: as for `Sand`, none for all.
        groups: as for `Sand`, none for all.

    Raises:
        InputError: names the ground, and the options that help.
    """
    chosen = select_geoms(
        model,
        bodies=bodies or None,
        geoms=geoms or None,
        groups=groups or None,
        leave_out=surface.geoms(model),
    )
    floors = find_floors(model, chosen, surface)
    if floors:
        names = " ".join(model.geom(geom).name or str(geom) for geom in floors)
        raise InputError(
            f"{describe_floors(model, floors)}: take it out with --instead-of {names}, or say "
            "--keep-floor if it is to stand on that"
        )
