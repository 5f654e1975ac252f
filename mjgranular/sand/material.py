"""Medium and law of a sand: as asked for, or as they follow from each other and from the bodies."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import mujoco
import numpy as np

from mjgranular.errors import InputError, UnknownNameError, listed
from mjgranular.law import DistributedLinkLaw, Law, LinkLaw, get_law, law_in, laws
from mjgranular.law.rft import RftLaw
from mjgranular.medium import Medium, get_medium, media
from mjgranular.sand.spec import SandSpec

MEDIUM_OF_LINKS = "play_sand"
"""Taken for slender links: its law is that of links."""

MEDIUM_OF_BODIES = "quikrete_medium"
"""Taken for all other bodies: its law, `rft3d_dynamic`, takes every shape."""

_CAPSULE = int(mujoco.mjtGeom.mjGEOM_CAPSULE)
_CYLINDER = int(mujoco.mjtGeom.mjGEOM_CYLINDER)
_logger = logging.getLogger(__name__)


def material_of(model: mujoco.MjModel, geoms: Sequence[int], spec: SandSpec) -> tuple[Medium, Law]:
    """The medium and the law of a sand.

    What is given is taken. With a medium alone the law is the medium's own, with a law alone the
    medium is one that has constants for it, and with neither `play_sand` is taken for links and
    `quikrete_medium` for all else, each with its own law.

    Args:
        model: the model.
        geoms: ids of the geoms that meet the sand.
        spec: the sand.

    Raises:
        UnknownNameError: no such medium or law, or a medium without constants for the law; names
            the media that have them.
    """
    if spec.medium is not None:
        medium = get_medium(spec.medium)
    elif spec.law is not None:
        medium = medium_for(spec.law)
    else:
        medium = media[MEDIUM_OF_LINKS if are_links(model, geoms) else MEDIUM_OF_BODIES]
    law = law_of(spec.law, medium)
    if spec.medium is None:
        _logger.info("chosen by the bodies: medium %s, law %s", medium.name, law.name)
    return medium, law


def law_of(law: str | Law | type[Law] | None, medium: Medium) -> Law:
    """The law with a medium's constants; see `get_law`.

    Raises:
        UnknownNameError: no such law, or no constants for it; names the media that have them.
    """
    try:
        return get_law(law, medium)
    except UnknownNameError as error:
        others = [name for name in media if has_constants(media[name], law)]
        if error.kind == "law" or not others:
            raise
        hint = f"media with constants for it: {listed(others)}"
        raise UnknownNameError(error.kind, error.name, error.known, hint, guess=False) from None


def medium_for(law: str | Law | type[Law]) -> Medium:
    """The medium that is taken where a law alone is given.

    Raises:
        UnknownNameError: no such law; lists those there are.
    """
    if isinstance(law, str):
        law, _ = law_in(law)
    kind = type(law) if isinstance(law, Law) else law
    first = (MEDIUM_OF_LINKS, MEDIUM_OF_BODIES)
    for name in (*first, *(name for name in media if name not in first)):
        if has_constants(media[name], kind):
            return media[name]
    return media[MEDIUM_OF_LINKS]


def are_links(model: mujoco.MjModel, geoms: Sequence[int]) -> bool:
    """Tells whether all geoms are capsules, or cylinders at least as long as they are wide."""
    kinds, sizes = model.geom_type[geoms], model.geom_size[geoms]
    long = (kinds == _CYLINDER) & (sizes[:, 1] >= sizes[:, 0])
    return bool(((kinds == _CAPSULE) | long).all())


def elements_of(
    model: mujoco.MjModel, geoms: Sequence[int], law: Law, resolution: int | None
) -> np.ndarray:
    """The elements of a law; see `Law.elements`.

    Raises:
        InputError: geoms that the law has no elements for; for a law of links it names the media
            whose own law takes every shape.
    """
    try:
        return law.elements(model, geoms, resolution)
    except InputError as error:
        rods = np.isin(model.geom_type[geoms], (_CAPSULE, _CYLINDER)).all()
        if rods or not isinstance(law, (LinkLaw, DistributedLinkLaw)):
            raise
        every = [name for name in media if issubclass(laws[media[name].default_law], RftLaw)]
        raise InputError(
            f"{error}; or take a medium whose own law takes every shape: {listed(every)}"
        ) from None


def has_constants(medium: Medium, law: str | Law | type[Law] | None) -> bool:
    """Tells whether a law can be made of a medium's constants."""
    try:
        get_law(law, medium)
    except (InputError, UnknownNameError):
        return False
    return True
