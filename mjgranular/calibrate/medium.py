"""The medium before a fit, and the one that results from it."""

from dataclasses import MISSING, asdict, fields, replace
from pathlib import Path
from typing import Any

from mjgranular._util.checks import require
from mjgranular._util.io import place
from mjgranular.calibrate.fit import FitResult
from mjgranular.calibrate.material import DENSITY, STRENGTH, numbers_of
from mjgranular.errors import InputError
from mjgranular.law import DistributedLinkLaw, Law, LinkLaw, law_in, laws
from mjgranular.medium import Medium, Quantity, get_medium
from mjgranular.medium.file import check_mapping, number

_MEDIUM_KEYS = ("base", "name", "title", "density", "grain")


def known_medium(
    entry: Any, law: str | Law | None, path: Path, *, source: str | None = None
) -> Medium:
    """Return the medium of a file of runs: constants by their names, optionally based on another.

    The entry is a mapping with `base` (a medium's name or file), `name`, `title`, `density`,
    `grain` and constants of the law; or the name of a medium. The law is by default that of the
    base; the source of the constants is by default the file.
    """
    where = f"{place(path)}: medium"
    base, name = None, entry.get("base") if isinstance(entry, dict) else entry
    if name is not None and isinstance(entry, str | dict):
        name = str(name)  # a file is next to that of the runs
        base = get_medium(path.parent / name if name.endswith((".yaml", ".yml")) else name)
        if isinstance(entry, str):
            return base
    if law is not None:
        kind = type(law) if isinstance(law, Law) else law_in(law)[0]
    elif base is not None:
        kind = laws[base.default_law]
    else:
        raise InputError(f"{where} has no base whose law could be taken: name the law (--law)")
    numbers, key = numbers_of(kind), _table(kind)
    given = _given(entry, kind, where, source or f"given in {path.name}")
    density = given.get("density") or (base and base.density)
    if density is None:
        raise InputError(f"{where} needs the bulk density [kg/m^3]: density, or a base")
    own = {} if base is None else _constants_of(kind, base)
    own |= {k: q for k, q in given.items() if k in numbers}
    if DENSITY in numbers:
        own.setdefault(DENSITY, density)
    stated = law_in(law)[1].keys() if isinstance(law, str) else ()
    for field in fields(kind):  # pyright: ignore[reportArgumentType]
        if field.default is MISSING and field.name not in own and field.name not in stated:
            raise InputError(
                f"{where}: the law {kind.name!r} needs the constant {field.name!r}: give a guess"
            )
    try:
        return Medium(
            name=str(entry.get("name") or path.stem),
            title=str(entry.get("title") or f"the sand of {path.name}"),
            density=density,
            grain=given.get("grain") or (base and base.grain),
            default_law=key,
            constants={**(base.constants if base else {}), key: own},
        )
    except InputError as error:
        raise InputError(f"{place(path)}: {error}") from None


def _given(entry: dict[str, Any], kind: type[Law], where: str, source: str) -> dict[str, Quantity]:
    units = {"density": "kg/m^3", "grain": "m"}
    names = [*units, *(name for name in numbers_of(kind) if name not in units)]
    keys = dict.fromkeys((*_MEDIUM_KEYS, *names))
    check_mapping(entry, f"{where} with the law {kind.name!r}", keys)
    return {
        key: Quantity(number(entry[key], f"{where}.{key}"), units.get(key, ""), source)
        for key in entry
        if key in names
    }


def _table(kind: type[Law]) -> str:
    """Return the law name of a medium's constants: the law's own, or that of one with the same."""
    return LinkLaw.name if issubclass(kind, (LinkLaw, DistributedLinkLaw)) else kind.name


def _constants_of(kind: type[Law], medium: Medium) -> dict[str, Quantity]:
    key = medium.key_for(kind.name)
    if key is None:
        return dict(medium.constants.get(_table(kind), {}))
    law = kind.from_medium(medium)
    return {
        name: replace(quantity, value=float(getattr(law, name)))
        for name, quantity in medium.constants[key].items()
    }


def fitted_medium(result: FitResult, name: str, *, source: str = "") -> Medium:
    """Return the fitted medium: free constants with intervals, the others unchanged."""
    material, start = result.material, result.start
    before, kind = start.medium, type(material.law)
    key, known = _table(kind), _constants_of(kind, before)
    constants = {}
    for constant, value in material.constants().items():
        quantity = known.get(constant)
        if quantity is None or quantity.value != value:
            unit = quantity.unit if quantity else ""
            quantity = Quantity(value, unit, _found(result, constant, source))
        constants[constant] = quantity
    density = before.density
    if material.medium.density.value != density.value:
        density = Quantity(material.medium.density.value, "kg/m^3", _found(result, DENSITY, source))
    return replace(before, name=name, density=density, default_law=key, constants={key: constants})


def _found(result: FitResult, constant: str, source: str) -> str:
    to = f"fitted by mjgranular fit to {source}" if source else "fitted by mjgranular fit"
    if constant in result.values:
        return f"{to}; {_interval(result, constant)}"
    changed = result.start.value(constant) != result.material.value(constant)
    if STRENGTH in result.values and changed:
        return f"{to}, as the strength {result.values[STRENGTH]:.4g}; {_interval(result, STRENGTH)}"
    return "as at the start of the fit"


def _interval(result: FitResult, name: str) -> str:
    low, high = ("open" if end is None else f"{end:.4g}" for end in result.intervals[name])
    doubt = "" if result.identifiable[name] else "; these data do not determine it"
    return f"95 % interval {low} to {high}{doubt}"


def medium_text(medium: Medium) -> str:
    """Return a medium as a YAML string that `read_medium` reads."""
    yaml = require("yaml", extra="fit", purpose="Writing a medium")
    content = {name: value for name, value in asdict(medium).items() if value is not None}
    style = {"sort_keys": False, "default_flow_style": None, "allow_unicode": True}
    return yaml.safe_dump(content, width=10_000, **style)
