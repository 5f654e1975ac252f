"""The validity page, generated from comparisons."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from motions import SLOW, SLOW_SPHERE, THIN, Range, ranges
from quantities import QUANTITIES, accuracy, values
from tables import FILES, write_tables

from mjgranular.calibrate import MARKS, compare

if TYPE_CHECKING:
    from comparison import Comparison

_DEFAULT = "rft3d_dynamic"
# Worst errors of trajectories and final depths, in whole percents as they are printed; chosen.
_GOOD, _ROUGH = 0.1, 0.25

_HEAD = """# Accuracy of the laws

<!-- Written by `python referee/validate.py`: change that, not this. -->

The default law, `{law}`, against all measurements in the repository. *Bias* is the mean of the
relative errors, positive if the law gives too much; *spread* is their standard deviation. *Blind*
data played no part in the law: drops and tilted bodies were simulated when its form was fixed
but for (S5) and the cone of faces that move obliquely, which came later and were chosen without
them; at the others nobody had looked. Runs that a constant was fitted to are not counted.

{quantities}

To correct a prediction, divide it by one plus the bias. Its uncertainty is then the spread,
divided by the same number. {example}

Some sets are simulations of grains (discrete elements) made for this project; the others were
published. Most quantities have few values: treat a bias smaller than the spread as zero.

## Verdict by law

A law is *good* for a motion if the trajectories and final depths or forces of all runs are within
{good}, and an *estimate* if the trajectories are within {rough}. The number is the worst error of
a trajectory: for a drop the RMS error of depth over its duration, relative to the final depth;
for a robot the mean error of its speeds; otherwise the RMS error of force, relative to the
largest force. Spheres, feet and rods are dropped. Pushes and drags are slow to a Froude number of
{slow:g}, spheres to {slow_sphere:g}; thin rods are less than {thin} grains wide.

{verdicts}

`rft2d` and `rft3d` with `inertia` or `added` switched on ([Faster
motion](laws/rft.md#faster-motion)) are in the files below. Constants that you choose or fit
yourself have other errors. `depth_velocity` has constants for one sphere only, which it was
compared with.

## Errors in reports

`report(data)[body].error` and `info["sand/error"]` give the worst trajectory error of the law in
a group of measured drops, pushes and drags: the slowest group that is at least as fast (by Froude
number), of bodies as thin in grains. So it jumps when a fall slows down. They are `None` and 1
where nothing as fast was compared. A report gives no error for a body that turns in the sand, such
as a leg or a wheel.

## Data

Each run has one of three labels for each law:

{labels}

The figures show each run with every law:

{sets}

{files}

Errors are fractions of the measured value. Depth and force at the end are called *final*; *stop*
is the time from touch until the center of mass is slower than 1 % of its largest speed; *peak* is
the largest force after a 1 ms mean. `python referee/validate.py` repeats all comparisons and
writes this page, its files and figures, and the errors in reports; `referee/README.md` says how
to add a set.

## Limits of the data

{beds}
- Not compared: swimmers, wheels with grousers, feet that push off, sand on slopes, sand with
  memory, wet sand, and gravity other than Earth's.
- Published drops are lines fitted to measurements, not the measurements.
- Simulated grains are round, and most do not resist rolling: their friction is at the lower end of
  sands.
"""


def write_page(file: Path, found: list[list[Comparison]], figures: dict[str, str]) -> None:
    """Write the page, and its CSV files to a folder of the same name."""
    write_tables(file.with_suffix(""), found)
    text = _HEAD.format(
        law=_DEFAULT,
        quantities="\n".join(_quantities(found)),
        example=_example(found),
        slow=SLOW,
        slow_sphere=SLOW_SPHERE,
        thin=THIN,
        good=_percent(_GOOD, sign=False),
        rough=_percent(_ROUGH, sign=False),
        verdicts="\n".join(_verdicts(found)),
        labels="\n".join(f"- *{mark}*: {meaning};" for mark, meaning in MARKS.items())[:-1] + ".",
        sets="\n".join(_sets(found, figures)),
        files=_files(file.stem),
        beds="\n".join(_small_beds(found)),
    )
    file.write_text(text)


def _table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    lines = ["| " + " | ".join(headings) + " |", "|" + "---|" * len(headings)]
    return lines + ["| " + " | ".join(row) + " |" for row in rows]


def _percent(value: float | None, sign: bool = True) -> str:
    if value is None:
        return ""
    rounded = round(100 * value)  # no "-0"
    return f"{rounded:+d} %" if sign and rounded else f"{rounded:d} %"


def _quantities(found: list[list[Comparison]]) -> list[str]:
    """Return bias and spread of the default law by quantity."""
    mine = [v for v in values(found) if v.comparison.candidate.name == _DEFAULT]
    rows = []
    for quantity, title in QUANTITIES.items():
        here = [v for v in mine if v.quantity == quantity]
        blind = [v for v in here if v.comparison.mark == "blind"]
        cells = []
        for chosen in (here, blind):
            a = accuracy(chosen)
            count = str(a.values) if a.values else ""
            cells += [_percent(a.bias), _percent(a.spread, sign=False), count]
        if here:
            rows.append((title, *cells))
    headings = ("quantity", "bias", "spread", "values", "blind: bias", "spread", "values")
    return _table(headings, rows)


def _example(found: list[list[Comparison]]) -> str:
    """Return how to use bias and spread, for the stopping time."""
    stops = accuracy(
        v for v in values(found) if v.comparison.candidate.name == _DEFAULT and v.quantity == "stop"
    )
    if stops.bias is None or stops.spread is None:
        return ""
    return (
        f"A stopping time of 40 ms, for example, means {40 / (1 + stops.bias):.0f} ms, "
        f"give or take {_percent(stops.spread / (1 + stops.bias), sign=False)}."
    )


def _verdicts(found: list[list[Comparison]]) -> list[str]:
    """Return what each law of the package is good for."""
    all_ = ranges(found)
    laws = [law for law in dict.fromkeys(r.law for r in all_) if " " not in law]
    laws.sort(key=lambda law: law != _DEFAULT)
    return [f"- `{law}`: {_verdict([r for r in all_ if r.law == law])}." for law in laws]


def _verdict(rows: list[Range]) -> str:
    groups: dict[str, list[str]] = {"good": [], "estimate": [], "not reliable": []}
    for r in rows:
        worst = round(r.worst, 2)
        if max(worst, round(r.worst_final, 2)) <= _GOOD:
            verdict = "good"
        else:
            verdict = "estimate" if worst <= _ROUGH else "not reliable"
        fitted = " (fitted)" if r.fitted else ""
        groups[verdict].append(f"{r.motion} {_percent(r.worst, sign=False)}{fitted}")
    return "; ".join(f"**{name}** {', '.join(items)}" for name, items in groups.items() if items)


def _sets(found: list[list[Comparison]], figures: dict[str, str]) -> list[str]:
    return [
        f"- [`{group[0].runs.name}`](figures/{figures[group[0].runs.name]}): "
        f"{group[0].runs.title[0].upper()}{group[0].runs.title[1:]}"
        for group in found
    ]


def _files(folder: str) -> str:
    links = [f"[{name}]({folder}/{name}): {content}" for name, content in FILES.items()]
    return "Tables:\n\n" + "\n".join(f"- {link}" for link in links)


_SMALLER = (
    (
        ("seen", "sphere 1 m/s"),
        "sphere 25.4 mm, 1 m/s again",
        "A sphere of 25.4 mm at 1 m/s in a bed of a fifth of the grains, 2.4 spheres wide",
    ),
    (
        ("wide_bed", "flat foot 0.5 m/s"),
        "flat foot 0.5 m/s",
        "A foot of 30 mm at 0.5 m/s in a bed two feet wide instead of three",
    ),
)
"""Drops in two beds: set and run of the larger one, run of `small_bed`, description."""


def _small_beds(found: list[list[Comparison]]) -> list[str]:
    """Return the effect of a smaller bed on the same drop."""
    sets = {group[0].runs.name: group[0].runs for group in found}
    lines = []
    for (name, large), small, text in _SMALLER:
        if not {name, "small_bed"} <= sets.keys():
            continue
        errors = compare(sets[name][large].motion, sets["small_bed"][small].motion)
        lines.append(
            f"- {text}: final depth {_percent(errors.final)}, stopping time "
            f"{_percent(errors.stopping_time)}. Errors below that are those of the bed."
        )
    return lines
