"""Medium and law of a sand: as given, or derived from each other and from the model."""

from dataclasses import replace

import mujoco

from mjgranular.errors import InputError, UnknownNameError
from mjgranular.law import Law, get_law, law_in
from mjgranular.medium import Medium, get_medium, media
from mjgranular.sand.spec import SandSpec

DEFAULT_MEDIUM = "quikrete_medium"
"""The medium where neither medium nor law is given: its law, `rft3d_dynamic`, takes every shape."""

LAW_TEXT = "mjgranular.law"
"""Name of the custom text in which a model names the law that it is made for."""

_FIRST_MEDIA = ("play_sand", DEFAULT_MEDIUM)
"""Media that are searched first for a law's constants if only a law is given."""


def material_of(model: mujoco.MjModel, spec: SandSpec) -> tuple[Medium, Law]:
    """Return the medium and the law of a sand.

    With a medium alone the law is the medium's default; with a law alone the medium is one that has
    constants for it. With neither, the law is the one that the model names in its custom text
    `LAW_TEXT`, as the package's link does, else that of `DEFAULT_MEDIUM`.

    Raises:
        InputError: a density follows the medium's name, and the law does not depend on it.
    """
    law = spec.law
    if spec.medium is None and law is None:
        law = law_named_in(model)
    if spec.medium is not None:
        medium = get_medium(spec.medium)
    else:
        medium = media[DEFAULT_MEDIUM] if law is None else medium_for(law)
    found = get_law(law, medium)
    if medium.name == spec.medium and "density=" in medium.name:
        value = 1000.0 if medium.density.value != 1000.0 else 2000.0  # any other
        other = replace(medium, density=replace(medium.density, value=value))
        numbers = get_law(law, other).parameters(other)
        if numbers.tobytes() == found.parameters(medium).tobytes():
            raise InputError(
                f"{spec.medium!r}: the density of the medium has no effect under the law "
                f'{found.name}; constants of a law follow its name, as in "rft3d density=1500"'
            )
    return medium, found


def law_named_in(model: mujoco.MjModel) -> str | None:
    """Return the content of the model's custom text `LAW_TEXT`; None if it has none."""
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TEXT, LAW_TEXT)
    if number < 0:
        return None
    start, size = model.text_adr[number], model.text_size[number]
    return bytes(model.text_data[start : start + size]).rstrip(b"\0").decode(errors="replace")


def medium_for(law: str | Law) -> Medium:
    """Return the default medium of a law."""
    kind = type(law) if isinstance(law, Law) else law_in(law)[0]
    for name in (*_FIRST_MEDIA, *(name for name in media if name not in _FIRST_MEDIA)):
        if has_constants(media[name], kind):
            return media[name]
    return media[_FIRST_MEDIA[0]]


def has_constants(medium: Medium, law: type[Law]) -> bool:
    """Return True if a medium has the constants of a law."""
    try:
        law.from_medium(medium)
    except (InputError, UnknownNameError):
        return False
    return True
