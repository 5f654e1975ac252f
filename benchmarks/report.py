"""Figures as tables: in the terminal, as JSON, in a page of the documentation."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from measure import UNITS, Figure, Group
from rich.console import Console
from rich.table import Table

BEGIN, END = "<!-- figures: written by benchmarks/run.py -->", "<!-- end of figures -->"
"""Parts of a page around the generated part."""

_NAMES = {"us/step": "µs a step", "ms": "ms"}
assert _NAMES.keys() == UNITS.keys()


def show(console: Console, group: Group, figures: dict[str, Figure], before: Any) -> None:
    """Print the figures of a group, next to earlier ones if there are any."""
    table = Table(title=group.title, title_justify="left")
    table.add_column("case")
    for heading in (_NAMES[group.unit], "quartiles", "ratio", "quartiles"):
        table.add_column(heading, justify="right")
    if before:
        table.add_column("before", justify="right")
        table.add_column("change", justify="right")
    for name, figure in figures.items():
        row = [name, *_words(figure)]
        if before:
            row += _beside(figure, before.get(name))
        table.add_row(*row)
    console.print(table)


def _words(figure: Figure) -> list[str]:
    return [
        _number(figure.cost),
        f"{_number(figure.cost_low)} to {_number(figure.cost_high)}",
        _number(figure.ratio),
        f"{_number(figure.ratio_low)} to {_number(figure.ratio_high)}",
    ]


def _number(value: float) -> str:
    """Format a number with three significant digits and a thousands separator."""
    return f"{value:.3g}" if value < 99.95 else f"{value:,.0f}".replace(",", "\u202f")


def _beside(figure: Figure, before: dict[str, Any] | None) -> list[str]:
    """Compare ratios, not times: the machine may be another, or busier."""
    if before is None:
        return ["", ""]
    return [_number(before["ratio"]), f"{figure.ratio / before['ratio'] - 1:+.0%}"]


def save(path: Path, machine: dict[str, Any], found: dict[str, dict[str, Figure]]) -> None:
    """Write the figures to a JSON file."""
    plain = {
        title: {name: figure.plain() for name, figure in figures.items()}
        for title, figures in found.items()
    }
    content = json.dumps({"machine": machine, "figures": plain}, indent=2)
    path.write_text(content + "\n", encoding="utf-8")


def read(path: Path) -> dict[str, Any]:
    """Return the figures of a file from `save`, in plain values."""
    return json.loads(path.read_text(encoding="utf-8"))["figures"]


def markdown(machine: dict[str, Any], found: list[tuple[Group, dict[str, Figure]]]) -> str:
    """Return the figures as part of a page."""
    lines = [
        f"{machine['processor']}, {machine['cores']} cores, {machine['platform']}. Python "
        f"{machine['python']}, MuJoCo {machine['mujoco']}, mjgranular {machine['mjgranular']}, "
        f"numba {machine['numba']}, NumPy {machine['numpy']}. {machine['date']}. Medians of "
        f"{machine['turns']} turns, quartiles in brackets.",
        "",
    ]
    for group, figures in found:
        lines += [f"### {group.title}", "", group.note, ""]
        lines += [f"| case | {_NAMES[group.unit]} | ratio |", "|---|---|---|"]
        for name, figure in figures.items():
            cost, costs, ratio, ratios = _words(figure)
            lines.append(f"| {name} | {cost} ({costs}) | {ratio} ({ratios}) |")
        lines.append("")
    return "\n".join(lines)


def around_figures(path: Path) -> tuple[str, str]:
    """Return what stands before and after the figures of a page; there need not be a page yet."""
    if not path.exists():
        return "", "\n"
    head, begin, rest = path.read_text(encoding="utf-8").partition(BEGIN)
    _, end, tail = rest.partition(END)
    if not (begin and end):
        raise SystemExit(f"{path} has no place for figures: the lines {BEGIN!r} and {END!r}")
    return head, tail


def page_of(text: str, head: str, tail: str) -> str:
    """Return a page with figures between `BEGIN` and `END`."""
    return f"{head}{BEGIN}\n\n{text}\n{END}{tail}"
