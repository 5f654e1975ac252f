"""`mjgranular compare`: does it matter that ground is sand?"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.table import Table

from mjgranular.cli.console import out, print_json, progress_bar, show_error
from mjgranular.cli.engines import PlaceOptions
from mjgranular.errors import InputError, MissingExtraError, UnknownNameError
from mjgranular.experiment.folder import SUMMARY, ResultFolder
from mjgranular.learn.compare import GROUNDS, Cell, compare
from mjgranular.learn.evaluate import check_seeds

_FIGURE = "compare.png"


@dataclass(frozen=True)
class CompareCommand(PlaceOptions):
    """Trains a robot on rigid ground, on sand and on randomised sand; evaluates each on all.

    The runs lie in DIR. What is trained already is taken as it is: after an interruption the same
    command goes on. Workers take a run at a time; on a cluster all nodes must have DIR at the same
    path. Prints the mean return for each pair of grounds, and draws it.
    """

    robot: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="Hopper|Hexapod")]
    """The robot."""
    policies: Annotated[int, tyro.conf.arg(metavar="N")] = 3
    """Policies for each ground, with seeds of their own."""
    seeds: Annotated[int, tyro.conf.arg(metavar="N")] = 10
    """Episodes for each policy on each ground."""
    total_steps: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Of each training. Default: as in the settings."""
    set: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE ...")] = ()
    """Changes of the settings, as for `mjgranular train`."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder for the runs. Default: runs/compare-ROBOT."""
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print a JSON list instead of a table."""

    def run(self) -> int:
        """Runs the command."""
        _ = self.where  # which checks itself
        if self.policies < 1:
            raise InputError(f"a comparison needs at least 1 policy, not {self.policies}")
        check_seeds(self.seeds)
        path = self.out or Path("runs") / f"compare-{self.robot}"
        if self.robot not in GROUNDS:
            raise UnknownNameError("robot to compare grounds with", self.robot, GROUNDS)
        with ResultFolder(path, (SUMMARY, _FIGURE)).claimed(overwrite=True) as folder:
            return self._run(folder)

    def _run(self, folder: ResultFolder) -> int:
        with progress_bar("preparing", 1.0) as show:
            cells = compare(
                self.robot,
                folder.path,
                policies=self.policies,
                seeds=self.seeds,
                total_steps=self.total_steps,
                changes=self.set,
                on=self.where,
                report=lambda what, done: show(done, what),
            )
        if isinstance(cells, int):
            show_error("stopped, all that was learned is kept; the same command goes on")
            return 128 + cells
        with folder.published():
            folder.write_json(SUMMARY, [cell.as_json() for cell in cells])
        if self.json:
            print_json([cell.as_json() for cell in cells])
        else:
            out.print(table_of(cells, self.robot, self.policies))
        try:
            from mjgranular.learn.figures import draw_comparison

            title = f"{self.robot}: mean return"
            folder.write(_FIGURE, lambda file: draw_comparison(file, cells, title=title))
        except MissingExtraError as error:
            show_error(f"{error} (the numbers are in {folder.path})")
            return 2
        return 0


def table_of(cells: list[Cell], robot: str, policies: int) -> Table:
    """A row for each ground trained on, a column for each evaluated on."""
    grounds = list(dict.fromkeys(cell.on for cell in cells))
    table = Table(
        title=f"{robot}: mean return ± half the 95 % interval, {policies} "
        f"{'policy' if policies == 1 else 'policies'} for each ground",
        title_justify="left",
    )
    table.add_column("trained on")
    for ground in grounds:
        table.add_column(f"on {ground}", justify="right")
    for trained_on in grounds:
        row = {cell.on: str(cell.returned) for cell in cells if cell.trained_on == trained_on}
        table.add_row(trained_on, *(row[ground] for ground in grounds))
    return table
