"""`mjgranular intrude`: force on an intruder that is moved on a prescribed path."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from mjgranular.cli.console import err, out, print_json, show_error, table
from mjgranular.cli.options import LawOptions, given_options, record_of
from mjgranular.errors import InputError, MissingExtraError
from mjgranular.experiment.folder import CONFIG, SUMMARY, ResultFolder
from mjgranular.experiment.intrusion import Intrusion, IntrusionResult, run_intrusion

_CSV = "intrusion.csv"
_FIGURE = "intrusion.png"
_ROWS_SHOWN = 11


@dataclass(frozen=True)
class IntrudeCommand(LawOptions):
    """A plate, a sphere or your own geom is moved through sand on a straight path: force on depth.

    The intruder is moved, not pushed. Prints resistance against the motion, lift across it, and
    whether the law held. With --out DIR, writes table and figure there.
    """

    medium: Annotated[str, tyro.conf.arg(metavar="NAME")] = "quikrete_medium"
    """The sand, or a YAML file; see `mjgranular list media`."""
    intruder: Literal["plate", "sphere", "cylinder", "capsule", "box"] | None = None
    """Shape, if no model is given; a cylinder or capsule stands upright, a quarter as thick.
    Default: plate."""
    size: Annotated[float | None, tyro.conf.arg(metavar="M")] = None
    """Edge or diameter or height of that shape [m]; a plate is a tenth as thick. Default: 0.04."""
    model: Annotated[Path | None, tyro.conf.arg(metavar="MODEL.xml")] = None
    """MJCF file to take the intruder from."""
    geom: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None
    """Geom in that file. Default: all of it."""
    tilt: Annotated[float, tyro.conf.arg(metavar="DEG")] = 0.0
    """Tilt of the intruder: positive lifts its +x side [degrees]."""
    direction: Annotated[float, tyro.conf.arg(metavar="DEG")] = 90.0
    """Direction of motion below the horizontal: 90 is straight down, 0 along +x [degrees]."""
    speed: Annotated[float, tyro.conf.arg(metavar="M/S")] = 0.01
    """Speed [m/s]; matters to laws with inertia and to validity."""
    start: Annotated[float, tyro.conf.arg(metavar="M")] = 0.0
    """Depth of the deepest point at the start [m]."""
    depth: Annotated[float, tyro.conf.arg(metavar="M")] = 0.1
    """Depth of the deepest point at the end [m]."""
    distance: Annotated[float | None, tyro.conf.arg(metavar="M")] = None
    """Length of the path [m]. Default: as far as --depth asks for."""
    points: Annotated[int, tyro.conf.arg(metavar="N")] = 101
    """Number of samples."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder for the results; nothing is written without it."""
    overwrite: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Replace a result that the folder holds already."""
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print a JSON list instead of a table."""

    def run(self) -> int:
        """Runs the command."""
        intrusion = self.intrusion()
        if self.out is None:
            self._show(run_intrusion(intrusion))
            return 0
        names = (CONFIG, SUMMARY, _CSV, _FIGURE)
        with ResultFolder(self.out, names).claimed(overwrite=self.overwrite) as folder:
            result = run_intrusion(intrusion)
            rows = result.rows()
            with folder.published():
                folder.write_config("intrude", {**intrusion.config(), "law": result.law})
                folder.write(_CSV, lambda path: _write_csv(path, result))
                folder.write_json(SUMMARY, rows)
            self._show(result)
            try:
                from mjgranular.picture.figures import draw_intrusion

                title = f"{self._what()}, {self.medium}, {result.law} law"
                folder.write(
                    _FIGURE,
                    lambda path: draw_intrusion(
                        path, result.depth, result.force, result.moment, title=title
                    ),
                )
            except MissingExtraError as error:
                show_error(f"{error} (the numbers are in {self.out})")
                return 2
        if not self.json:
            out.print(f"written to {self.out}", highlight=False, markup=False)
        return 0

    def _what(self) -> str:
        if self.model is not None:
            return self.geom or self.model.name
        intrusion = self.intrusion()
        return f"{intrusion.intruder} of {intrusion.size * 1e3:g} mm"

    def intrusion(self) -> Intrusion:
        """The intrusion that is asked for."""
        shape = {"intruder": self.intruder, "size": self.size}
        given = {name: value for name, value in shape.items() if value is not None}
        if self.model is not None and given:
            raise InputError(
                f"the intruder is a shape or of a model: leave --model or --{min(given)} away"
            )
        if self.distance is not None and given_options(self, "depth"):
            raise InputError(
                "--depth and --distance both say where the path ends: leave one of the two away"
            )
        own = {name: getattr(Intrusion, name) for name in shape}
        return record_of(Intrusion, self, **{**own, **given})

    def _show(self, result: IntrusionResult) -> None:
        rows = result.rows()
        if self.json:
            print_json(rows)
            return
        title = f"{self._what()} in {self.medium}: {result.law} law, {result.elements} elements"
        headings = (
            "travelled\n[mm]",
            "depth\n[mm]",
            "resistance\n[N]",
            "lift\n[N]",
            "sideways\n[N]",
        )
        step = max(1, (len(rows) - 1) // (_ROWS_SHOWN - 1))
        cells = [
            (
                f"{row['travelled'] * 1e3:.1f}",
                f"{row['depth'] * 1e3:.1f}",
                f"{row['resistance']:.4g}",
                f"{row['lift']:.4g}",
                f"{row['sideways']:.4g}",
            )
            for row in rows[::step]
        ]
        out.print(table(title, headings, cells, words=0))
        outside = int((~result.valid).sum())
        if outside:
            err.print(
                f"the law is outside its validity at {outside} of {len(rows)} points",
                highlight=False,
            )


def _write_csv(path: Path, result: IntrusionResult) -> None:
    units = {"travelled": "m", "depth": "m", "valid": "-"}
    rows = result.rows()
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(
            f"{key} [{units.get(key, 'N m' if key.startswith('moment') else 'N')}]"
            for key in rows[0]
        )
        writer.writerows(row.values() for row in rows)
