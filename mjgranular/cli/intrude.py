"""`mjgranular intrude`: force on an intruder that is moved on a prescribed path."""

import csv
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

from mjgranular._util.result_folder import CONFIG, SUMMARY
from mjgranular.cli.console import note, out, print_result, table
from mjgranular.cli.options import OutputOptions, collected, options_of
from mjgranular.errors import GranularError
from mjgranular.experiment.intrusion import Intrusion, IntrusionResult, run_intrusion
from mjgranular.picture.elements import count
from mjgranular.picture.figures import draw_intrusion

_CSV = "intrusion.csv"
_FIGURE = "intrusion.png"
_ROWS_SHOWN = 11


@dataclass(frozen=True, kw_only=True)
class IntrudeCommand(OutputOptions, options_of(Intrusion)):
    """Move a plate, a sphere or your own geom through sand on a straight path: force by depth.

    The intruder is moved, not pushed. Prints resistance against the motion, lift across it, and
    whether the law held. With --out DIR, writes table and figure there.
    """

    def run(self) -> int:
        intrusion = self.experiment()
        problems: list[GranularError] = []
        with self.claimed(CONFIG, SUMMARY, _CSV, _FIGURE) as folder:
            result = run_intrusion(intrusion)
            if folder is not None:
                config = {**asdict(intrusion), "law": result.law}
                with folder.published("intrude", config, result.rows()):
                    folder.write(_CSV, lambda path: _write_csv(path, result))
            print_result(result.rows(), partial(self._show, result), json=self.json)
            if folder is not None:
                title = f"{intrusion.title}, {self.medium}, {result.law} law"
                drawn = (result.depth, result.force, result.moment)
                with collected(problems):
                    folder.write(_FIGURE, lambda path: draw_intrusion(path, *drawn, title=title))
        return self.finish(problems)

    def _show(self, result: IntrusionResult) -> None:
        rows = result.rows()
        title = (
            f"{result.intrusion.title} in {self.medium}: {result.law} law, "
            f"{count(result.elements, 'elements')}"
        )
        headings = ("travelled\n[mm]", "depth\n[mm]", "resistance\n[N]", "lift\n[N]")
        step = max(1, (len(rows) - 1) // (_ROWS_SHOWN - 1))
        cells = [
            (
                f"{row['travelled'] * 1e3:.1f}",
                f"{row['depth'] * 1e3:.1f}",
                *(f"{row[name]:.4g}" for name in ("resistance", "lift", "sideways")),
            )
            for row in rows[::step]
        ]
        out.print(table(title, (*headings, "sideways\n[N]"), cells, words=0))
        outside = int((~result.valid).sum())
        if outside:
            note(f"the law is outside its validity at {outside} of {len(rows)} points")


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
