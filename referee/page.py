"""The validity page, generated from comparisons."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from findings import findings

from mjgranular.calibrate import MARKS, MeasuredRun, compare
from mjgranular.calibrate.motion import gain

if TYPE_CHECKING:
    from comparison import Comparison

    from mjgranular.calibrate import Errors

_DATA = Path(__file__).parent / "data"
# Worst errors of trajectories and final depths, and of stopping times; chosen.
_BELIEVE, _BELIEVE_STOP, _ESTIMATE = 0.1, 0.2, 0.25

_HEAD = """# How far the laws are right

<!-- Written by `python referee/validate.py`: change that, not this. -->

{quantities}
Every law of the package against every set of measured motion that the repository has, and what
came out, the bad with the good. `python referee/validate.py` repeats it and writes this page, its
figures and the errors in `report(data)[body].error` and `info["sand/error"]`: those of drops,
pushes and drags. Those of wheels and turning legs are only on this page; a report gives no error
for a body that turns in the sand. The data are in `referee/data`; `referee/README.md` says how
grains are simulated and how to add a set.

Errors are those of whole motions:

- *trajectory*: of a drop the root-mean-square of the error in depth over time, in parts of the
  final depth; of a robot the mean error of its speeds; else that in force, a vector where lift was
  measured, in parts of the greatest;
- *final*: error of the final depth, of a push or drag that of the force in the last fifth of the
  path; of forces on legs and wheels by least squares; mean error of a robot's speeds;
- *stop*: error of the time from the touch until the mass centre is slower than 1 % of its greatest
  speed;
- *peak*: error of the greatest force after a mean over 1 ms;
- *pitch*: error of the final angle from the vertical;
- *lift*, *sinkage*: of lift by least squares, of a wheel's depth the mean error.

A final depth alone proves little: a law that is too weak at first and too strong later can end
right. Errors are those of the law with the constants that are said, not of the best constants.
Each run has a mark:
"""


def _is_ball(run: MeasuredRun) -> bool:
    return run.kind == "drop" and run.shape == "sphere"


_LED = ("intrude", "drag")

_SITUATIONS: tuple[tuple[str, Callable[[MeasuredRun, float], bool]], ...] = (
    (
        "plate or ball pushed or drawn, Froude number to 0.4",
        lambda r, g: r.kind in _LED and r.froude <= 0.4,
    ),
    ("plate pushed or drawn, faster", lambda r, g: r.kind in _LED and r.froude > 0.4),
    ("leg that turns slowly", lambda r, g: r.kind == "turn"),
    ("wheel, slow, at its sinkage", lambda r, g: r.kind == "roll"),
    ("wheel, slow, free to sink", lambda r, g: r.kind == "sink"),
    ("robot that walks", lambda r, g: r.kind == "walk"),
    ("sphere dropped, to 2.5", lambda r, g: _is_ball(r) and r.froude <= 2.5),
    ("sphere dropped, faster", lambda r, g: _is_ball(r) and r.froude > 2.5),
    ("flat foot dropped", lambda r, g: r.shape == "plate" and r.kind == "drop"),
    ("rod dropped, 5 grains wide or more", lambda r, g: r.shape == "capsule" and g >= 5),
    ("rod dropped, thinner", lambda r, g: r.shape == "capsule" and g < 5),
)


def write_page(file: Path, found: list[list[Comparison]], figures: dict[str, str]) -> None:
    """Write the page."""
    lines = [_HEAD.replace("{quantities}", "\n".join(_quantities(found)))]
    lines += [f"- *{mark}*: {meaning};" for mark, meaning in MARKS.items()]
    lines[-1] = lines[-1][:-1] + "."
    lines += ["", "## Which law to believe when", "", *_when(found), ""]
    lines += ["## The error that travels with a force", "", *_travels(found), ""]
    for group in found:
        lines += _set(group, figures[group[0].runs.name])
    lines += _small_beds(found)
    lines += _missing()
    file.write_text("\n".join(lines).rstrip() + "\n")


def _table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    lines = ["| " + " | ".join(headings) + " |", "|" + "---|" * len(headings)]
    return lines + ["| " + " | ".join(row) + " |" for row in rows]


def _percent(value: float | None, sign: bool = True) -> str:
    if value is None:
        return ""
    rounded = round(100 * value)  # no "-0"
    return f"{rounded:+d} %" if sign and rounded else f"{rounded:d} %"


_DEFAULT = "rft3d_dynamic"
_QUANTITIES = {
    "depth": "depth of what is dropped",
    "stop": "stopping time",
    "push": "force against a push",
    "drag": "drag of what is drawn",
    "lift": "lift of what is drawn or turns",
    "thrust": "thrust of a leg",
    "walk": "walking speed",
    "bear": "vertical force on a wheel at its sinkage",
    "pull": "horizontal force on a wheel free to sink",
    "sinkage": "sinkage of a wheel free to sink",
}


def _parts(c: Comparison) -> Iterable[tuple[str, float]]:
    """Yield relative errors of a comparison by quantity; rows that are separate runs count each."""
    run, motion, e = c.run.motion, c.motion, c.errors
    assert e is not None
    assert motion is not None

    def rows(name: str, column: str) -> Iterable[tuple[str, float]]:
        one, other = getattr(run, column), getattr(motion, column)
        return (
            []
            if one is None
            else [(name, float(b / a) - 1) for a, b in zip(one, other, strict=True)]
        )

    if c.run.kind == "drop":
        return [("depth", e.final), *([] if e.stop is None else [("stop", e.stop)])]
    if c.run.kind == "intrude":
        return [("push", e.final)]
    if c.run.kind == "drag":
        return [*rows("drag", "force"), *rows("lift", "lift")]
    if c.run.kind == "walk":
        return rows("walk", "speed")
    if c.run.kind == "turn":
        assert e.lift is not None
        return [("thrust", e.final), ("lift", e.lift)]
    if c.run.kind == "roll":
        return rows("bear", "lift")
    # Many of the wheel's forces are near zero: vectors are compared by least squares.
    one, other = (np.array([m.force, m.side]).ravel() for m in (run, motion))
    return [("pull", gain(one, other)), *rows("sinkage", "depth")]


def _quantities(found: list[list[Comparison]]) -> list[str]:
    """Return bias and spread of the default law, by quantity and label."""
    errors: dict[tuple[str, bool], list[float]] = {}
    for c in (c for group in found for c in group):
        # The link paper's drops are computed from its law, not measured.
        if c.candidate.name != _DEFAULT or c.errors is None or c.runs.name == "paper_link":
            continue
        for name, error in () if c.mark == "fitted to" else _parts(c):
            errors.setdefault((name, c.mark == "blind"), []).append(error)

    def cells(name: str, blind: bool) -> tuple[str, str, str]:
        values = errors.get((name, blind), [])
        if not values:
            return "", "", ""
        spread = _percent(float(np.std(values)), sign=False) if len(values) > 1 else ""
        return _percent(float(np.mean(values))), spread, str(len(values))

    rows = [
        (title, *cells(name, False), *cells(name, True))
        for name, title in _QUANTITIES.items()
        if (name, False) in errors or (name, True) in errors
    ]
    headings = ("quantity", "bias", "spread", "values", "blind: bias", "spread", "values")
    return [
        f"The default law, `{_DEFAULT}`, against all measurements: mean error (*bias*) and",
        "standard deviation of the errors (*spread*), in parts of the measured value. The first",
        "three columns are of runs that authors of laws knew, the last three of *blind* ones, made",
        "after the law and every constant were fixed. Runs that a constant was fitted to are not",
        "counted.",
        "",
        *_table(headings, rows),
        "",
    ]


def _when(found: list[list[Comparison]]) -> list[str]:
    all_ = [c for group in found for c in group if c.runs.name != "paper_link"]
    names = list(dict.fromkeys(c.candidate.name for c in all_))
    rows = []
    for title, belongs in _SITUATIONS:
        cells: list[str] = []
        best: dict[str, list[Errors]] = {}
        for name in names:
            mine = [
                c
                for c in all_
                if c.candidate.name == name and c.errors is not None and belongs(c.run, _grains(c))
            ]
            judged = [c for c in mine if c.mark != "fitted to"]
            if not mine:
                cells.append("")
                continue
            errors = [c.errors for c in judged or mine if c.errors is not None]
            text = _span([e.trajectory for e in errors]) + ("" if judged else " (fitted)")
            stops = [e.stop for e in errors if e.stop is not None]
            if stops and judged:
                low, high = _percent(min(stops)), _percent(max(stops))
                text += f"; stop {low}" + (f" to {high}" if high != low else "")
            cells.append(text)
            if judged and name != "depth_velocity":
                best[name] = errors
        rows.append((title, *cells, _verdict(best)))
    lines = [
        "Errors of trajectories, from the best to the worst run, and of stopping times. Runs that",
        "a law's own constants were fitted to are left out where there are others. In the last",
        "column stands the law whose worst trajectory is the best. *Believe* it where all its",
        "trajectories and final depths are within 10 % and its stopping times within 20 %; take it",
        "for an *estimate* of depths and forces where trajectories are within 25 %; beyond that do",
        "*not*. `depth_velocity` has constants for one sphere only, and is not named there.",
        "",
    ]
    return lines + _table(("motion", *(f"`{n}`" for n in names), "so"), rows)


def _grains(c: Comparison) -> float:
    grain = c.runs.medium.grain
    return c.run.width / grain.value if grain is not None else 100.0


def _span(errors: Sequence[float]) -> str:
    low, high = min(errors), max(errors)
    if round(100 * low) == round(100 * high):
        return _percent(high, sign=False)
    return f"{100 * low:.0f} to {100 * high:.0f} %"


def _verdict(best: dict[str, list[Errors]]) -> str:
    """Return the recommended law and its accuracy."""
    if not best:
        return "not compared"
    worst = {name: max(e.trajectory for e in errors) for name, errors in best.items()}
    name = min(worst, key=lambda key: worst[key])
    finals = max(abs(e.final) for e in best[name])
    stops = max((abs(e.stop) for e in best[name] if e.stop is not None), default=0.0)
    text = f"`{name}`, {_percent(worst[name], sign=False)}"
    if worst[name] > _ESTIMATE:
        return f"do not believe any; least wrong {text}"
    if max(worst[name], finals) <= _BELIEVE and stops <= _BELIEVE_STOP:
        return f"believe {text}"
    return f"estimate: {text}" + (f", stops {_percent(stops, sign=False)} off" if stops else "")


def _travels(found: list[list[Comparison]]) -> list[str]:
    lines = [
        "The worst error of trajectories in groups of measured runs, by their greatest Froude",
        "number; without runs that the law's constants were fitted to, and without the link",
        "paper's own drops, which nobody has measured. A force takes the first line that reaches",
        "its Froude number and whose bodies were as thin in grains; where no grain size is known a",
        "body counts as wide. Beyond the last line nothing is known, and the error is `None`.",
        "`inertia` is the same law with its inertial term switched on, `added` with an added mass",
        "beside it ([Faster motion](laws/rft.md#faster-motion)). Constants other than those",
        "compared here have errors of their own.",
        "",
    ]
    rows = [
        (f"`{law}`", f"{froude:g}", f"{grains:g}", _percent(error, sign=False), str(runs))
        for law, table in findings(found).items()
        for froude, grains, error, runs in table
    ]
    return lines + _table(("law", "Froude number to", "grains across", "error", "runs"), rows)


def _set(group: list[Comparison], figure: str) -> list[str]:
    runs = group[0].runs
    about = json.loads((_DATA / runs.name / "about.json").read_text())
    lines = [f"## {runs.title}", "", f"`referee/data/{runs.name}`. {_sentence(runs.source)}"]
    if about.get("doubts"):
        lines[-1] += f" Doubts: {_sentence(about['doubts'])}"
    lines += ["", f"![{runs.title}](figures/{figure})", ""]
    rows = []
    for c in group:
        if c.errors is None:
            continue
        e = c.errors
        pitch = "" if e.pitch is None else f"{round(e.pitch):+d}°"
        rows.append(
            (
                c.run.name,
                f"{c.run.froude:.2g}",
                f"`{c.candidate.name}`",
                c.mark,
                _percent(e.trajectory, sign=False),
                _percent(e.final),
                _percent(e.stop),
                _percent(e.peak),
                pitch,
                _percent(e.lift),
                _percent(e.depth),
            )
        )
    headings = (
        *("run", "Froude", "law", "mark", "trajectory", "final", "stop", "peak", "pitch"),
        *("lift", "sinkage"),
    )
    used = [i for i in range(len(headings)) if any(row[i] for row in rows)]
    lines += _table([headings[i] for i in used], [[row[i] for i in used] for row in rows])
    lines += ["", "Constants:", ""]
    constants = {c.candidate.name: c.candidate.constants for c in group if c.errors is not None}
    lines += [f"- `{name}`: {text};" for name, text in constants.items()]
    lines[-1] = lines[-1][:-1] + "."
    return [*lines, ""]


def _sentence(text: str) -> str:
    text = text.strip()
    return text[0].upper() + text[1:] + ("" if text.endswith(".") else ".")


_SMALLER = (
    (
        ("seen", "sphere 1 m/s"),
        "sphere 25.4 mm, 1 m/s again",
        "The sphere of 25.4 mm at 1 m/s once more, in a bed of a fifth of the grains, 2.4 spheres "
        "wide",
    ),
    (
        ("wide_bed", "flat foot 0.5 m/s"),
        "flat foot 0.5 m/s",
        "The foot of 30 mm at 0.5 m/s in a bed two feet wide, against one three feet wide",
    ),
)
"""Drops in two beds: set and run of the larger one, run of `small_bed`, description."""


def _small_beds(found: list[list[Comparison]]) -> list[str]:
    """Return the effect of a smaller bed: the same drop in both."""
    sets = {group[0].runs.name: group[0].runs for group in found}
    lines = ["## What a smaller bed costs", ""]
    for (name, large), small, text in _SMALLER:
        if not {name, "small_bed"} <= sets.keys():
            return []
        errors = compare(sets[name][large].motion, sets["small_bed"][small].motion)
        lines += [
            f"{text}: final depth {_percent(errors.final)}, stopping time {_percent(errors.stop)}, "
            f"trajectory {_percent(errors.trajectory, sign=False)}, greatest force "
            f"{_percent(errors.peak)}. Laws are judged no better than that there.",
            "",
        ]
    return lines


def _missing() -> list[str]:
    return [
        "## What is not here",
        "",
        "Wheels with grousers, swimmers, feet that push off, sand on slopes, sand that remembers,",
        "wet sand. Raw measurements of drops: papers show them in figures, and the published sets",
        "are the lines through them. Simulated grains are round and most do not resist rolling, so",
        "that their friction is at the lower end of sands.",
        "",
    ]
