"""What an attack has found: a table, a file, and for each failure what it takes to see it again."""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from attacks.draw import draw
from rich.console import Console
from rich.table import Table

_MOST_CASES = 3  # of a kind, written out

_SCRIPT = '''\
"""Seed {seed}, model {number}, step {step}, {door}: {kind}.

{text}
"""

import mujoco
import numpy as np

import mjgranular
from mjgranular import *

model = mujoco.MjModel.from_xml_path("model.xml")
sand = Sand(model, {sand})
data = mujoco.MjData(model)
# Lines that are run before a step; counted from where the simulation last began anew.
events = {events}
for step in range({steps}):
    for line in events.get(step, ()):
        print(step, line)
        if line == "report":
            sand.report(data)
            continue
        try:
            exec(line)
        except (IndexError, ValueError, TypeError):
            pass  # the model has nothing of that kind
    sand.step(data)
print("qvel", data.qvel)
'''


@dataclass
class Tally:
    """All that has been told so far."""

    models: int = 0
    seconds: float = 0.0
    megabytes: int = 0
    counts: Counter[str] = field(default_factory=Counter)
    findings: list[dict[str, Any]] = field(default_factory=list)
    others: dict[str, list[str]] = field(default_factory=dict)

    def add(self, row: dict[str, Any]) -> None:
        """Adds what one model has brought."""
        self.models += 1
        self.seconds += row["seconds"]
        self.megabytes = max(self.megabytes, row.get("megabytes", 0))
        self.counts.update(row["counts"])
        self.findings += row["findings"]

    @property
    def failures(self) -> list[dict[str, Any]]:
        """Findings against what is promised."""
        return [finding for finding in self.findings if finding["failed"]]

    @property
    def failed(self) -> bool:
        """Tells whether anything is against what is promised."""
        return bool(self.failures) or any(self.others.values())

    def by_kind(self) -> dict[tuple[str, bool], list[dict[str, Any]]]:
        """Findings by kind, those that failed first."""
        kinds: dict[tuple[str, bool], list[dict[str, Any]]] = defaultdict(list)
        for finding in sorted(self.findings, key=lambda f: (not f["failed"], f["kind"])):
            kinds[finding["kind"], finding["failed"]].append(finding)
        return kinds


def show(tally: Tally, console: Console) -> None:
    """Prints counts and findings."""
    counts = Table(title=f"{tally.models} models", title_justify="left")
    counts.add_column("what")
    counts.add_column("number", justify="right")
    for name, number in sorted(tally.counts.items()):
        if not name.startswith("found: "):
            counts.add_row(name, f"{number:,}")
    counts.add_row("most memory of a process [MB]", f"{tally.megabytes:,}")
    console.print(counts)
    if tally.findings:
        table = Table(title="found", title_justify="left")
        for name in ("kind", "failed", "models", "greatest", "seed:number (step, door)"):
            table.add_column(name, overflow="fold")
        for (kind, failed), found in tally.by_kind().items():
            numbers = sorted({f["number"] for f in found})
            worst = max(found, key=lambda f: f["value"])
            places = ", ".join(
                f"{f['seed']}:{f['number']} ({f['step']}, {f['door']})" for f in found[:6]
            )
            table.add_row(kind, "yes" if failed else "no", str(len(numbers)), worst["text"], places)
        console.print(table)
    for name, texts in tally.others.items():
        console.print(f"{name}: {len(texts)} failures" if texts else f"{name}: no failure")
        for text in texts[:20]:
            console.print(f"  {text}", markup=False)


def write(
    tally: Tally,
    folder: Path,
    *,
    steps: int,
    programs: Iterable[Any],
    kind: str | None = None,
    **about: Any,
) -> None:
    """Writes `report.json`, and the first cases of each kind in folders of their own."""
    folder.mkdir(parents=True, exist_ok=True)
    content = {
        **about,
        "steps": steps,
        "models": tally.models,
        "counts": dict(sorted(tally.counts.items())),
        "kinds": {
            f"{kind}{'' if failed else ' (no failure)'}": len({f["number"] for f in found})
            for (kind, failed), found in tally.by_kind().items()
        },
        "others": tally.others,
        "findings": tally.findings,
    }
    (folder / "report.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    for (_, failed), found in tally.by_kind().items():
        for finding in found[:_MOST_CASES] if failed else ():
            write_case(finding, folder, steps, tuple(programs), kind)


def write_case(
    finding: dict[str, Any], folder: Path, steps: int, programs: Any, kind: str | None = None
) -> Path:
    """Writes the model and a script for one finding; gives the folder."""
    seed, number = finding["seed"], finding["number"]
    drawn = draw(seed, number, steps, programs, kind)
    words = "".join(c if c.isalnum() else "-" for c in finding["kind"]).strip("-")
    into = folder / f"{words}-{seed}-{number}"
    into.mkdir(parents=True, exist_ok=True)
    begun = finding["about"].get("begun at", 0)
    events = {
        step - begun: lines
        for step, lines in sorted(drawn.plan.events.items())
        if begun <= step <= max(finding["step"], 0)
    }
    rows = "".join(f"    {step}: {lines!r},\n" for step, lines in events.items())
    script = _SCRIPT.format(
        **{key: finding[key] for key in ("seed", "number", "step", "door", "kind", "text")},
        sand=drawn.model.sand,
        events=f"{{\n{rows}}}",
        steps=finding["step"] - begun + 1,
    )
    (into / "model.xml").write_text(drawn.model.xml, encoding="utf-8")
    (into / "reproduce.py").write_text(script, encoding="utf-8")
    return into
