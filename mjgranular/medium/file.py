"""Media by their names: those that come with the package, and those of YAML files."""

import csv
import math
import re
from collections.abc import Collection, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from mjgranular._util.checks import check_kind, kind_of, require
from mjgranular._util.io import place, read_file
from mjgranular._util.parse import Registry, parse_number
from mjgranular.errors import InputError, UnknownNameError, shown
from mjgranular.medium.medium import Medium, Quantity

media: Registry[Medium] = Registry("medium", "import its module, or name a .yaml file")
"""Media by their names."""

_OPTIONS = re.compile(r"(.*?\S)((?:\s+\w+=\S*)+)\s*")


def register_medium(medium: Medium, *, replace: bool = False) -> Medium:
    """Register a medium by its name, for use wherever a medium's name is accepted.

    Raises:
        InputError: another medium has that name and `replace` is false, or it is not a medium.
    """
    check_kind(medium, Medium, "register_medium", "read_medium(path) for a YAML file")
    media.add(medium.name, medium, replace=replace)
    return medium


def get_medium(medium: str | Path | Medium) -> Medium:
    """Return the medium of a name, or `medium` itself if it is one.

    A path, or a name that ends in .yaml or .yml, is that of a file. `density=1500` after a name
    changes the bulk density [kg/m^3].

    Raises:
        UnknownNameError: no such name; lists those that exist.
        InputError: the file does not describe a medium.
    """
    if isinstance(medium, Medium):
        return medium
    if isinstance(medium, str) and medium in media:
        return media[medium]
    if isinstance(medium, str) and (words := _OPTIONS.fullmatch(medium)):
        return _with_options(get_medium(words[1]), words[2].split(), medium)
    if isinstance(medium, dict):
        raise InputError("a medium is a Medium, its name, or a YAML file, not a dict")
    if isinstance(medium, Path) or str(medium).endswith((".yaml", ".yml")):
        return read_medium(Path(medium))
    if isinstance(medium, str) and Path(medium).suffix:
        raise UnknownNameError("medium", medium, media, "a medium's file ends in .yaml or .yml")
    return media[medium]


def _with_options(medium: Medium, options: list[str], name: str) -> Medium:
    """Return a medium of another density, the only option: constants are options of laws."""
    given = dict(option.split("=", 1) for option in options)
    others = given.keys() - {"density"}
    if others or len(given) < len(options):
        raise InputError(
            f"{shown(name)}: behind a medium's name stands density=KG/M^3 and nothing else; "
            'constants of a law stand behind the law\'s name, as in "rft3d scale=1.3"'
        )
    density = parse_number(given["density"])
    if density is None:
        raise InputError(f"density must be a number, not {shown(given['density'])}")
    return replace(medium, name=name, density=Quantity(density, "kg/m^3", "given by the user"))


LARGEST = 100_000
"""Size up to which a file is read [bytes]; chosen, ten times what a medium with every law needs."""

EXAMPLE = """\
name: my_sand
title: Sand of the beach at home
density: {value: 1500, unit: kg/m^3, source: weighed}
default_law: link
constants:
  link:
    eta_d: {value: 6.5, source: guessed}
    eta_h: {value: 8, source: guessed}
    eta_v: {value: 22, source: guessed}
    exponent: {value: 1.1, source: guessed}
"""
"""An example of such a file. `grain: {value: ..., unit: m, source: ...}` is optional."""

_REQUIRED = ("name", "title", "density", "default_law", "constants")


def read_medium(path: str | Path) -> Medium:
    """Read a medium from a YAML file of the form of `EXAMPLE`.

    The file may be untrusted: nothing in it is executed, and at most `LARGEST` is read.

    Raises:
        InputError: the path cannot be read, is not a file, or is too large; a key is missing; or a
            value is not a number or out of range; says which.
    """
    if not isinstance(path, (str, Path)):
        raise InputError(f"a medium is read from a file, not from {kind_of(path)}")
    path = Path(path)
    outline = read_outline_file(path, "the medium", largest=LARGEST, extra="media")
    try:
        return _medium(outline)
    except InputError as error:
        raise InputError(f"{place(path)}: {error}") from None


def _medium(content: Any) -> Medium:
    check_mapping(content, "a medium", (*_REQUIRED, "grain"), needed=_REQUIRED)
    if not isinstance(content["constants"], dict):
        raise InputError("constants must map names of laws to their constants")
    constants = {}
    for law, values in content["constants"].items():
        if not isinstance(values, dict):
            raise InputError(f"constants.{_key(law)} must map names to values")
        constants[law] = {
            key: _quantity(f"constants.{_key(law)}.{_key(key)}", value)
            for key, value in values.items()
        }
    grain = content.get("grain")
    return Medium(
        name=_text("name", content["name"]),
        title=_text("title", content["title"]),
        density=_quantity("density", content["density"], "kg/m^3", "kg/m³"),
        grain=None if grain in (None, "", "~", "null") else _quantity("grain", grain, "m"),
        default_law=_text("default_law", content["default_law"]),
        constants=constants,
    )


def _quantity(key: str, entry: Any, *units: str) -> Quantity:
    if not isinstance(entry, dict) or "value" not in entry or "source" not in entry:
        raise InputError(
            f"{key} must be {{value: NUMBER, unit: UNIT, source: WHERE FROM}}, not {shown(entry)}"
        )
    unit = entry.get("unit", "")
    if units and unit not in ("", *units):
        raise InputError(f"{key} must be in {units[0]}, not {shown(unit)}: units do not convert")
    return Quantity(
        number(entry["value"], f"{key}.value"),
        _text(f"{key}.unit", unit),
        _text(f"{key}.source", entry["source"]),
    )


def check_mapping(
    entry: Any, where: str, keys: Collection[str], *, needed: Iterable[str] = ()
) -> None:
    """Check that an entry of a file is a mapping with known keys."""
    known = ", ".join(keys)
    if not isinstance(entry, dict):
        raise InputError(f"{where} must be a mapping with {known}")  # it may be any file's content
    for key in entry:
        if key not in keys:
            raise InputError(f"{where} has no key {shown(key)}; there are: {known}")
    for key in needed:
        if not entry.get(key):
            raise InputError(f"{where} needs {key}")


def number(value: Any, key: str) -> float:
    """Return a finite number from a file."""
    found = parse_number(value) if isinstance(value, str) else None
    if found is None or not math.isfinite(found):
        raise InputError(f"{key} must be a number, without its unit, got {shown(value)}")
    return found


def _text(key: str, value: Any) -> str:
    if not isinstance(value, str):
        raise InputError(f"{key} must be a string, got {shown(value)}")
    return value


def _key(key: str) -> str:
    return shown(key)[1:-1]


def read_outline_file(path: Path, what: str, *, largest: int, extra: str) -> Any:
    """Read a YAML file of at most `largest` bytes: dicts, lists and strings.

    PyYAML's `BaseLoader` constructs nothing else: no object, date, number or None is made from a
    file. `what` is the expected content, for messages; `extra` installs PyYAML.
    """
    yaml = require("yaml", extra=extra, purpose=f"Reading {what} from a file")
    content = read_file(path, what, largest=largest)

    class Loader(yaml.BaseLoader):
        def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
            found = super().construct_mapping(node, deep=deep)
            if len(found) < len(node.value):
                problem, where = "a key stands twice in a mapping", node.start_mark
                raise yaml.constructor.ConstructorError(None, None, problem, where)
            return found

    try:
        return yaml.load(content.decode("utf-8"), Loader=Loader)
    except RecursionError:
        reason = "it is nested too deeply"
    except UnicodeDecodeError as error:
        reason = f"byte {error.start} is not UTF-8"
    except (yaml.YAMLError, ValueError, OverflowError) as error:  # the last two of \U escapes
        problem = getattr(error, "problem", None) or getattr(error, "reason", None) or "unreadable"
        mark = getattr(error, "problem_mark", None)
        reason = f"{'' if mark is None else f'line {mark.line + 1}: '}{str(problem)[:100]}"
    raise InputError(f"{place(path)} is not YAML that can be read: {reason}")


FOURIER_KEYS = ("A00", "A10", "B11", "B01", "Bm11", "C11", "C01", "Cm11", "D10")
GENERIC_FOURIER = (0.206, 0.169, 0.212, 0.358, 0.055, -0.124, 0.253, 0.007, 0.088)
_GENERIC_SOURCE = (
    "Li, Zhang, Goldman, Science 339, 1408 (2013), supplementary table S2: generic set"
)

_MEDIA = {
    # The paper's coefficients assume the density of quartz grains, not of a bed of them.
    "play_sand": ("Play sand (Quikrete 1113-51)", "link"),
    "quikrete_medium": ("Quikrete medium sand", "rft3d_dynamic"),
    "glass_beads": ("Glass beads, 250 to 350 um", "rft2d_dynamic"),
    "yuma_sand": ("Sand of Yuma", "rft2d_dynamic"),
    "twentynine_palms_sand": ("Sand of 29 Palms", "rft2d_dynamic"),
    # Li, Zhang and Goldman 2013. Their tables give 2500 to 2600 kg/m^3 for grains of glass: the
    # mean is used. The default law is the one that was validated for fast motion
    # (docs/validity.md), not the table for plates. With the measured alpha_z of a level plate
    # pushed straight down, where the Fourier series is 5 to 28 % softer, `scale` of `rft3d` is
    # alpha_z / (LEVEL_PLATE density 9.81 FRICTION_CUBIC(internal_friction)) (`law.rft3d`).
    "poppy_seed_loose": ("Poppy seed, loosely packed", "rft3d_dynamic"),
    "poppy_seed_close": ("Poppy seed, closely packed", "rft3d_dynamic"),
    "glass_beads_loose": ("Glass beads of 0.3 mm, loosely packed", "rft3d_dynamic"),
    "glass_beads_close": ("Glass beads of 0.3 mm, closely packed", "rft3d_dynamic"),
    "glass_beads_3mm_close": ("Glass beads of 3 mm, closely packed", "rft3d_dynamic"),
}
"""Title and default law of the media in `media.csv`, which has a row for each constant."""


def _register() -> None:
    """Register all media; `rft2d` has the generic set where a medium has only a scale of it."""
    with Path(__file__).with_name("media.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    for name, (title, default_law) in _MEDIA.items():
        tables: dict[str, dict[str, Quantity]] = {}
        for row in rows:
            if row["medium"] == name:
                quantity = Quantity(float(row["value"]), row["unit"], row["source"])
                tables.setdefault(row["law"], {})[row["constant"]] = quantity
        general = tables.pop("")  # density, and perhaps the size of grains
        if "scale" in tables.get("rft2d", {}):
            both = zip(FOURIER_KEYS, GENERIC_FOURIER, strict=True)
            generic = {key: Quantity(value, "N/cm^3", _GENERIC_SOURCE) for key, value in both}
            tables["rft2d"] = generic | tables["rft2d"]
        register_medium(Medium(name, title, default_law=default_law, constants=tables, **general))


_register()
