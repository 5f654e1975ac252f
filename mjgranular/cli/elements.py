"""`mjgranular elements`: the elements into which a law cuts a model."""

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import mujoco
import tyro

from mjgranular._util.result_folder import ResultFolder
from mjgranular.cli.console import out, print_json, table
from mjgranular.cli.options import Flag, options_of
from mjgranular.errors import FloorWarning, loading
from mjgranular.experiment.drop import Drop, read, start_from
from mjgranular.picture.elements import check_file, count, draw_elements, kind_of
from mjgranular.sand import Sand
from mjgranular.sand.report import Names
from mjgranular.scheme import Explicit
from mjgranular.shape.sizes import geom_type

_CHOICE = ("medium", "law", "resolution", "bodies", "geoms", "groups", "keyframe")


@dataclass(frozen=True, kw_only=True)
class ElementsCommand(options_of(Drop, *_CHOICE)):
    """Count and draw the elements into which a law cuts your MJCF model: rods, facets or blobs.

    Prints for each geom the number of elements, with their area or length. With --figure FILE,
    draws them.
    """

    model: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL.xml")]
    """The MJCF file."""
    figure: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """File for the figure, .png, .svg or .pdf."""
    overwrite: Flag = False
    """Replace a figure that exists."""
    json: Flag = False
    """Print JSON instead of a table."""

    def run(self) -> int:
        if self.figure is None:
            self._show(self._cut()[0])
            return 0
        check_file(self.figure)
        folder = ResultFolder(self.figure.parent, (self.figure.name,))
        with folder.claimed(overwrite=self.overwrite):
            sand, data = self._cut()
            self._show(sand)
            folder.write(
                self.figure.name,
                lambda path: draw_elements(sand, data, file=path, title=self.model.name),
            )
        if not self.json:
            out.print(f"written to {self.figure}")
        return 0

    def _cut(self) -> tuple[Sand, mujoco.MjData]:
        """Return the model's sand, and the simulation in which it is drawn."""
        drop = self.experiment()
        with loading(drop.title):
            model = read(drop).compile()
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST  # RK4 would be an error
        data = mujoco.MjData(model)
        start_from(model, data, self.keyframe)
        with warnings.catch_warnings(action="ignore", category=FloorWarning):  # no step is made
            sand = Sand(model, drop.sand, scheme=Explicit(prescribed=True), shared=True)
        return sand, data

    def _show(self, sand: Sand) -> None:
        kind, rows = kind_of(sand), list(_rows(sand))
        sums = {"area": ("area\n[cm^2]", 1e4), "length": ("length\n[mm]", 1e3)}
        totals: dict[str, Any] = {"elements": len(sand.elements)}
        for key in sums:
            values = [row[key] for row in rows]
            totals[key] = None if None in values else sum(values)
        names = {
            "model": self.model.name,
            "law": str(sand.spec.law or sand.law.name),
            "medium": self.medium or sand.medium.name,
            "kind": kind,
        }
        if self.json:
            print_json({**names, **totals, "geoms": rows})
            return
        sums = {key: sums[key] for key in sums if totals[key] is not None}

        def cells(row: dict[str, Any]) -> list[str]:
            return [
                *(row.get(key, "") for key in ("body", "geom", "shape")),
                str(row["elements"]),
                *(f"{row[key] * factor:.4g}" for key, (_, factor) in sums.items()),
                f"{row['width'] * 1e3:.4g}" if "width" in row else "",
            ]

        if len(rows) > 1:
            rows.append({"body": "together", **totals})
        number = count(len(sand.elements), kind)
        title = f"{names['model']} in {names['medium']}: {names['law']} law, {number}"
        units = [heading for heading, _ in sums.values()]
        headings = ("body", "geom", "shape", kind, *units, "width\n[mm]")
        out.print(table(title, headings, map(cells, rows), words=3))


def _rows(sand: Sand) -> Iterator[dict[str, Any]]:
    """Yield a row for each geom, in the order of the elements, in SI units."""
    model, elements, kind = sand.model, sand.elements, kind_of(sand)
    names = Names.of(model, elements)
    for geom in dict.fromkeys(elements["geom"].tolist()):
        mine = elements[elements["geom"] == geom]
        yield {
            "body": names.bodies[int(mine["body"][0])],
            "geom": names.geoms[geom],
            "shape": geom_type(model, geom),
            "elements": len(mine),
            "area": float(mine["area"].sum()) if kind == "facets" else None,
            "length": float(2 * mine["half_length"].sum()) if kind == "rods" else None,
            "width": float(mine["width"][0]),
        }
