"""`mjgranular gait`: the best scripted gait from a search."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.table import Table
from rich.text import Text

from mjgranular.cli.console import out, print_json, progress_bar
from mjgranular.cli.engines import BlockEngineOptions, kept, tell_interrupted
from mjgranular.errors import InputError, warn_user
from mjgranular.experiment.folder import CONFIG, SUMMARY
from mjgranular.learn import environments
from mjgranular.learn.agents import make_gait
from mjgranular.learn.evaluate import evaluate, parse_variant
from mjgranular.learn.search import Search, journal_of, search_gaits
from mjgranular.pool import Mapped

_SHOWN = 8


@dataclass(frozen=True)
class GaitCommand(BlockEngineOptions):
    """The best scripted gait of an environment, from a grid over its parameters.

    Tries each for one episode, and the best one for ten more with other seeds: what a trained
    policy is to be measured by. Workers take 64 gaits at a time; the numbers are the same to the
    last bit.
    """

    environment: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="ENV", name="env")]
    """Id of the environment."""
    search: Annotated[int, tyro.conf.arg(metavar="N")] = 200
    """How many gaits to try, at least."""
    ranges: Annotated[
        tuple[str, ...], tyro.conf.arg(metavar="NAME=LOW:HIGH ...", name="range")
    ] = ()
    """Ranges of parameters. Default: the gait's own."""
    by: Annotated[str, tyro.conf.arg(metavar="NAME")] = "return"
    """What is to be great: return, or a number in info such as x_velocity."""
    on: Annotated[str, tyro.conf.arg(metavar="NAME=VALUE,...")] = ""
    """A variant of the environment, for example medium=glass_beads."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder for the results; nothing is written without it."""
    overwrite: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Replace a result that the folder holds already."""
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print one JSON object instead of a table."""

    def run(self) -> int:
        """Runs the command."""
        environments.find_spec(self.environment)
        ranges = dict(_range(text) for text in self.ranges)
        arguments = parse_variant(self.on)
        _ = self.where  # which checks itself
        asked = {"count": self.search, "ranges": ranges, "by": self.by}
        journal = journal_of(self.out, self.environment, arguments, **asked)
        names = (CONFIG, SUMMARY)
        with kept(journal, self.out, names, overwrite=self.overwrite, resume=self.resume) as folder:
            with progress_bar("trying gaits", self.search) as show:
                search = search_gaits(
                    self.environment,
                    arguments,
                    **asked,
                    on=self.where,
                    journal=journal,
                    progress=lambda done, total: show(done * self.search / total),
                )
            if isinstance(search, Mapped):
                return tell_interrupted(search, self.out)
            content = self._content(search, arguments)
            if folder is not None:
                config = {"environment": self.environment, "search": self.search, "ranges": ranges}
                with folder.published():
                    folder.write_config("gait", {**config, "by": self.by, "variant": self.on})
                    folder.write_json(SUMMARY, content)
            self._show(content)
        return 0

    def _content(self, search: Search, arguments: dict) -> dict:
        if search.edges:
            warn_user(
                f"the best gait is at the end of the range of {', '.join(search.edges)}: a better "
                "one may lie beyond; widen it with --range"
            )
        best = search.gaits[0].parameters
        score = evaluate(
            "gait",
            lambda env: make_gait(self.environment, env, best),
            self.environment,
            arguments,
        )
        return {"by": self.by, "tried": _rows(search), "best": {**score.as_json(), "gait": best}}

    def _show(self, content: dict) -> None:
        if self.json:
            print_json(content)
            return
        rows = content["tried"]
        table = Table(
            title=f"{self.environment}: the best of {len(rows)} gaits", title_justify="left"
        )
        for heading in (*rows[0]["gait"], content["by"]):
            table.add_column(Text(heading), justify="right")
        for row in rows[:_SHOWN]:
            table.add_row(*(f"{v:.3g}" for v in row["gait"].values()), f"{row['value']:.4g}")
        out.print(table)
        best = content["best"]
        said = [f"return {_interval(best['return'])}"]
        speed = best["figures"].get("x_velocity")
        if speed is not None:
            said.append(f"speed {_interval(speed)} m/s")
        count = len(best["seeds"])
        out.print(f"the best over {count} other seeds: {', '.join(said)}", highlight=False)


def _rows(search: Search) -> list[dict]:
    return [{"gait": found.parameters, "value": found.value} for found in search.gaits]


def _interval(mean: dict) -> str:
    return f"{mean['mean']:.4g} ± {(mean['high'] - mean['low']) / 2:.2g}"


def _range(text: str) -> tuple[str, tuple[float, float]]:
    name, _, ends = text.partition("=")
    low, _, high = ends.partition(":")
    try:
        return name.strip(), (float(low), float(high))
    except ValueError:
        raise InputError(f"a range is NAME=LOW:HIGH, not {text!r}") from None
