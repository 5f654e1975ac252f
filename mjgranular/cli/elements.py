"""`mjgranular elements`: what a law cuts a model into."""

from __future__ import annotations

import csv
import warnings
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import mujoco
import numpy as np
import tyro

from mjgranular._util.result_folder import CONFIG, SUMMARY
from mjgranular.cli.console import out, print_json, table
from mjgranular.cli.options import options_of, record_of
from mjgranular.cli.results import OutputOptions, collected
from mjgranular.errors import FloorWarning, GranularError, InputError
from mjgranular.experiment.drop import Drop, loading, read, start_from
from mjgranular.picture.elements import check_file, count, draw_elements, kind_of
from mjgranular.sand import Sand
from mjgranular.sand.cost import Cost
from mjgranular.sand.report import Names
from mjgranular.scheme import Explicit, Implicit

_CSV = "elements.csv"
_FIGURE = "elements.png"


@dataclass(frozen=True, kw_only=True)
class ElementsCommand(
    OutputOptions,
    options_of(Drop, "medium", "law", "resolution", "bodies", "geoms", "groups", "keyframe"),
):
    """Count and draw what a law cuts your MJCF model into: rods, facets or blobs.

    Prints for each geom how many elements there are, with their area or length. With --figure
    FILE, draws them; with --out DIR, writes figure, table and every element there.
    """

    model: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL.xml")]
    """The MJCF file."""
    color: Literal["body", "geom", "depth"] = "body"
    """What colors of the figure stand for; depth is that below the plane z = 0."""
    figure: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """File for the figure, .png, .svg or .pdf."""

    def run(self) -> int:
        """Run the command."""
        if self.out is not None and self.figure is not None:
            raise InputError("give --figure FILE for the figure alone or --out DIR, not both")
        if self.figure is not None:
            check_file(self.figure)
        if self.out is None and self.figure is None and self.color != "body":
            raise InputError("--color is for a figure: add --figure FILE or --out DIR")
        if self.figure is None:
            target, names = self.out, (CONFIG, SUMMARY, _CSV, _FIGURE)
        else:
            target, names = self.figure.parent, (self.figure.name,)
        problems: list[GranularError] = []
        with replace(self, out=target, figure=None).claimed(*names) as folder:
            sand, qpos = self._cut()
            summary = self._summary(sand)
            if folder is not None and self.out is not None:
                with folder.published():
                    folder.write_config("elements", {**self._config(), "law": _law(sand)})
                    folder.write(_CSV, lambda path: _write_csv(path, sand))
                    folder.write_json(SUMMARY, summary)
            self._show(summary)
            if folder is not None:
                drawn = {"qpos": qpos, "color": self.color, "title": self.model.name}
                with collected(problems):
                    folder.write(names[-1], lambda path: draw_elements(sand, file=path, **drawn))
        if self.figure is None:
            return self.finish(problems)
        for problem in problems:
            raise problem
        if not self.json:
            out.print(f"written to {self.figure}", highlight=False)
        return 0

    def _cut(self) -> tuple[Sand, np.ndarray]:
        """The model on its sand, and where its bodies are drawn."""
        drop = record_of(Drop, self)
        with loading(drop.title):
            model = read(drop).compile()
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST  # RK4 would be refused
        data = mujoco.MjData(model)
        start_from(model, data, self.keyframe)
        # No step is made: sand and floor in the model do not matter.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FloorWarning)
            sand = Sand(model, drop.sand, scheme=Explicit(prescribed=True), shared=True)
        return sand, data.qpos

    def _config(self) -> dict[str, Any]:
        """Options in plain values."""
        left_out = ("figure", "out", "overwrite", "json")
        config = {key: value for key, value in asdict(self).items() if key not in left_out}
        return {**config, "model": str(self.model)}

    def _summary(self, sand: Sand) -> dict[str, Any]:
        """Sums over the elements, SI units."""
        rows = list(_rows(sand))
        return {
            "model": self.model.name,
            "law": _law(sand),
            "medium": self.medium or sand.medium.name,
            "kind": kind_of(sand),
            "elements": len(sand.elements),
            "area": _total(rows, "area"),
            "length": _total(rows, "length"),
            "cost": asdict(Cost.of(len(sand.elements), Implicit())),
            "geoms": rows,
        }

    def _show(self, summary: dict[str, Any]) -> None:
        if self.json:
            print_json(summary)
            return
        kind, rows = summary["kind"], summary["geoms"]
        # What is summed up over the elements: heading, factor from SI units.
        sums = {"area": ("area\n[cm^2]", 1e4), "length": ("length\n[mm]", 1e3)}
        sums = {key: sums[key] for key in sums if summary[key] is not None}

        def cells(row: dict[str, Any]) -> list[str]:
            return [
                *(row[key] for key in ("body", "geom", "shape")),
                str(row["elements"]),
                *(f"{row[key] * factor:.4g}" for key, (_, factor) in sums.items()),
                f"{row['width'] * 1e3:.4g}" if "width" in row else "",
            ]

        together = {**summary, "body": "together", "geom": "", "shape": ""}
        title = f"{summary['model']} in {summary['medium']}: {summary['law']} law"
        headings = ("body", "geom", "shape", kind, *(heading for heading, _ in sums.values()))
        shown = map(cells, [*rows, together] if len(rows) > 1 else rows)
        title = f"{title}, {count(summary['elements'], kind)}"
        out.print(table(title, (*headings, "width\n[mm]"), shown, words=3))
        out.print(f"cost: {Cost(**summary['cost'])}", highlight=False)


def _law(sand: Sand) -> str:
    """The law as it was asked for, with its parameters, or the one that was chosen."""
    return str(sand.spec.law or sand.law.name)


def _rows(sand: Sand) -> Iterator[dict[str, Any]]:
    """One row a geom, body by body as the elements are, SI units."""
    model, elements, kind = sand.model, sand.elements, kind_of(sand)
    names = Names.of(model, elements)
    for geom in dict.fromkeys(elements["geom"].tolist()):
        mine = elements[elements["geom"] == geom]
        shape = mujoco.mjtGeom(int(model.geom_type[geom])).name.removeprefix("mjGEOM_").lower()
        yield {
            "body": names.bodies[int(mine["body"][0])],
            "geom": names.geoms[geom],
            "shape": shape,
            "elements": len(mine),
            "area": float(mine["area"].sum()) if kind == "facets" else None,
            "length": float(2 * mine["half_length"].sum()) if kind == "rods" else None,
            "width": float(mine["width"][0]),
        }


def _total(rows: list[dict[str, Any]], key: str) -> float | None:
    values = [row[key] for row in rows]
    return None if None in values else float(sum(values))


def _write_csv(path: Path, sand: Sand) -> None:
    """Every element with all that the law keeps of it, in the frame of its body."""
    elements, names = sand.elements, Names.of(sand.model, sand.elements)
    header = ["body", "geom"]
    columns: list[list[Any]] = [
        [names.bodies[body] for body in elements["body"].tolist()],
        [names.geoms[geom] for geom in elements["geom"].tolist()],
    ]
    units = {"normal": "-", "axis": "-", "axes": "-", "area": "m^2"}
    for field in elements.dtype.names or ():
        if field in ("body", "geom", "slot"):
            continue
        values = elements[field].reshape(len(elements), -1)
        for k, column in enumerate(values.T):
            name = field if values.shape[1] == 1 else f"{field}_{_place(k, values.shape[1])}"
            header.append(f"{name} [{units.get(field, 'm')}]")
            columns.append(column.tolist())
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows(zip(*columns, strict=True))


def _place(k: int, size: int) -> str:
    """Name of the k-th number of vectors: x, y, z of one vector; 1x to 3z of several."""
    axis = "xyz"[k % 3]
    return axis if size == 3 else f"{k // 3 + 1}{axis}"
