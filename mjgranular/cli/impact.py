"""`mjgranular impact`: one drop of the link, of another body or of a chain; the paper's table."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rich.table import Table

from mjgranular._util.result_folder import CONFIG, SUMMARY, ResultFolder
from mjgranular.cli import drop as models
from mjgranular.cli.console import out, print_json, progress_bar, table
from mjgranular.cli.filming import write_film
from mjgranular.cli.options import given_options, option, options_of, record_of
from mjgranular.cli.results import FilmOptions, OutputOptions, collected, note
from mjgranular.errors import GranularError, InputError
from mjgranular.experiment import CASES, Impact, ImpactResult, reproduce, run_drop, run_impact
from mjgranular.experiment.chain_impact import chain_drop, chain_length, chain_summary
from mjgranular.experiment.folder import RUN_FILES, write_drop, write_impact
from mjgranular.experiment.paper import comparison
from mjgranular.experiment.slips import warn_of_slips
from mjgranular.experiment.trajectory import Trajectory
from mjgranular.relief.memory import as_memory
from mjgranular.render import Tracks
from mjgranular.sand.prepare import fitted

if TYPE_CHECKING:
    from mjgranular.picture.video import Film

FIGURES = ("motion.png", "forces.png")
PROFILE = "prints.png"
VIDEO = "impact.mp4"


@dataclass(frozen=True, kw_only=True)
class ImpactCommand(FilmOptions, options_of(Impact, without=("body",))):
    """Drop the link onto sand: its end T meets the sand and stops.

    Prints stopping time and depth. With --out DIR, writes trajectory, summary, configuration and
    figures there; with --video, a film too.
    """

    body: Annotated[str, tyro.conf.arg(metavar="SHAPE")] = "link"
    """What falls: link, sphere, box, cylinder, capsule, ellipsoid, plate, or chain:N."""
    paper: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Run the six drops of the paper's table instead, and print them beside its values."""

    def run(self) -> int:
        """Run the command."""
        if self.paper:
            return self._run_paper()
        self.check_film()
        count = chain_length(self.body)
        if count is not None:
            return self._run_chain(count)
        if self.body == "sphere" and self.length != Impact.length:
            raise InputError("a sphere has no --length: its size is its --diameter")
        impact = self.experiment()
        film = self._film(impact) if self.video else None
        with self.claimed(*RUN_FILES, *FIGURES, PROFILE, VIDEO) as folder:
            with progress_bar("dropping the link", impact.duration) as progress:
                result = run_impact(impact, progress=progress)
            if folder is not None:
                write_impact(folder, result)
            if self.json:
                print_json(result.summary())
            else:
                out.print(impact_table(result))
                for line in remarks(result):
                    note(line)
            problems = [] if folder is None else _draw(folder, result, film)
        return self.finish(problems)

    def experiment(self) -> Impact:
        """Return what is asked for."""
        if self.paper:
            raise InputError("--paper has its own drops: a sweep takes one experiment")
        if chain_length(self.body) is not None:
            raise InputError("a sweep cannot drop a chain: write it as a model, for --of drop")
        return record_of(Impact, self)

    def _film(self, impact: Impact) -> Film:
        from mjgranular.picture.video import Film

        film = Film(camera=self.camera or "side")
        film.check(impact.link)
        return film

    def _run_chain(self, count: int) -> int:
        """Drop a chain of `count` links."""
        if self.until != "stop":
            raise InputError("--until is for one body: a chain is followed for its --duration")
        impact = record_of(Impact, self, body="link")
        drop = chain_drop(impact, count)
        models.check_film(self, drop)
        height: dict[str, float | None] = {"the height of release": impact.height}
        warn_of_slips(lengths=height, speed=impact.speed, density=impact.density)
        with self.claimed(*RUN_FILES, models.FIGURE, models.FILM) as folder:
            with progress_bar("dropping the chain", drop.duration) as progress:
                result = run_drop(drop, progress=progress)
            if folder is not None:
                write_drop(folder, result)
            if self.json:
                print_json(chain_summary(impact, count, result))
            else:
                models.show(result)
                end = "T, the end of the last link,"
                if result.stop is None:
                    out.print(f"{end} did not stop within {impact.duration:g} s")
                else:
                    time, depth = (1e3 * value for value in result.stop)
                    text = f"{end} stops after {time:.3f} ms, {depth:.3f} mm deep"
                    out.print(text, highlight=False)
            problems = [] if folder is None else models.draw(self, folder, result)
        return self.finish(problems)

    def _run_paper(self) -> int:
        """Run the paper's six drops."""
        free = ["paper", "timestep", "scheme", "law"]
        free += [each.name for each in fields(OutputOptions)]
        fixed = [each.name for each in fields(self) if each.name not in free]
        for name in given_options(self, *fixed):
            raise InputError(f"--paper has its own drops: omit {option(name)}")
        base = record_of(Impact, self)
        figures = {case: f"figure_{case.figure}.png" for case in CASES}
        problems: list[GranularError] = []
        with self.claimed(CONFIG, SUMMARY, *figures.values()) as folder:
            with progress_bar("dropping the paper's links", len(CASES)) as progress:
                results = reproduce(base, progress=progress)
            rows = [comparison(*pair) for pair in results]
            if folder is not None:
                with folder.published():
                    folder.write_config("impact --paper", asdict(base))
                    folder.write_json(SUMMARY, rows)
                for case, result in results:
                    with collected(problems):
                        _draw_motion(folder, figures[case], result.trajectory, result.summary())
            if self.json:
                print_json(rows)
            else:
                out.print(paper_table(rows, self.timestep))
        return self.finish(problems)


def paper_table(rows: list[dict[str, Any]], timestep: float) -> Table:
    """Make a table of the paper's drops beside its printed values."""
    cells = []
    for row in rows:
        time, depth = row["stopping_time"], row["depth"]
        late = None if time is None else time - row["paper_stopping_time"]
        cells.append(
            (
                f"{row['speed']:g}",
                f"{row['angle_deg']:g}",
                "not stopped" if time is None else f"{time * 1e3:.3f}",
                f"{row['paper_stopping_time'] * 1e3:.3f}",
                "" if late is None else f"{late * 1e6:+.1f}",
                f"{depth * 1e3:.3f}",
                f"{row['paper_depth'] * 1e3:.3f}",
                f"{(depth - row['paper_depth']) * 1e6:+.1f}",
            )
        )
    headings = ("speed\n[m/s]", "angle\n[deg]", "stopping\ntime [ms]", "paper\n[ms]")
    headings += ("diff.\n[us]", "depth\n[mm]", "paper\n[mm]", "diff.\n[um]")
    return table(f"The paper's six drops, time step {timestep:g} s", headings, cells, words=0)


def impact_table(result: ImpactResult) -> Table:
    """Make a table of the result."""
    summary = result.summary()
    impact = result.impact
    table = Table(
        title=f"Impact on sand: {result.impact.body}", show_header=False, title_justify="left"
    )
    for justify in ("left", "right", "left"):
        table.add_column(justify=justify, style="dim" if justify == "left" else "")

    def row(name: str, value: float | None, digits: str, unit: str) -> None:
        if value is not None:
            table.add_row(name, format(value, digits), unit)

    table.add_row("sand, law, scheme", f"{impact.medium}, {result.law}, {impact.scheme_taken}", "")
    row("time step", impact.timestep, "g", "s")
    row("speed of T", impact.speed, "g", "m/s")
    row("angle from the vertical", summary["angle_deg"], "g", "deg")
    row("tangential speed of T", impact.tangential_speed or None, "g", "m/s")
    row("angular velocity", impact.angular_velocity or None, "g", "rad/s")
    row("height of release", impact.height or None, "g", "m")
    table.add_section()
    if result.stop is None:
        table.add_row("stopping time", f"not within {impact.duration:g}", "s")
        row("greatest depth of T", summary["depth"] * 1e3, ".3f", "mm")
    else:
        row("stopping time", result.stop.time * 1e3, ".3f", "ms")
        row("depth of T at the stop", result.stop.depth * 1e3, ".3f", "mm")
        row("angle at the stop", math.degrees(result.stop.angle), ".2f", "deg")
        row("angular velocity at the stop", result.stop.angular_velocity, ".2f", "rad/s")
    row("greatest force of the sand", summary["greatest_force"], ".1f", "N")
    if result.rest is not None:
        row("at rest after", result.rest.time * 1e3, ".1f", "ms")
        row("depth of the deeper end at rest", result.rest.depth * 1e3, ".3f", "mm")
        row("angle at rest", math.degrees(result.rest.angle), ".2f", "deg")
    return table


def remarks(result: ImpactResult) -> list[str]:
    """Return what a person should know besides the numbers."""
    impact = result.impact
    lines = []
    if result.stop is None:
        lines.append(
            f"T did not stop within {impact.duration:g} s; a longer --duration may show it"
        )
    elif impact.until == "rest" and result.rest is None:
        omega = float(result.trajectory.omega[-1])
        line = f"not at rest after {impact.duration:g} s: it turns at {omega:.1f} rad/s"
        if result.law.split()[0] == "link":
            line += "; the lumped law does not resist turning about E, --law link_distributed does"
        lines.append(line)
    return lines


def release_to_stop(summary: dict[str, Any]) -> float | None:
    """Return the time from release to the stop [s], None if there was none."""
    if summary["stopping_time"] is None:
        return None
    return summary["touchdown_time"] + summary["stopping_time"]


def title(summary: dict[str, Any]) -> str:
    """Return the line above figures."""
    return (
        f"{summary['speed']:g} m/s, {summary['angle_deg']:g} deg, {summary['medium']}, "
        f"{summary['law']} law, {summary['scheme']}, {summary['timestep']:g} s"
    )


def _draw(folder: ResultFolder, result: ImpactResult, film: Film | None) -> list[GranularError]:
    """Draw the figures of a drop and its film; return what could not be drawn."""
    from mjgranular.picture.figures import draw_forces, draw_prints

    problems: list[GranularError] = []
    impact, summary, prints = result.impact, result.summary(), result.prints
    motion, forces = FIGURES
    stop, above = release_to_stop(summary), title(summary)
    with collected(problems):
        _draw_motion(folder, motion, result.trajectory, summary)
        folder.write(
            forces, lambda path: draw_forces(path, result.trajectory, stop=stop, title=above)
        )
    if prints is not None:
        memory = as_memory(fitted(impact.link.model(impact.timestep), impact.described).memory)
        assert memory is not None
        profile = prints.profile(memory)
        with collected(problems):
            folder.write(PROFILE, lambda path: draw_prints(path, *profile, title=above))
    if film is not None:
        with collected(problems):
            film_impact(folder, VIDEO, impact, result.trajectory, summary, film, prints)
    return problems


def _draw_motion(
    folder: ResultFolder, name: str, trajectory: Trajectory, summary: dict[str, Any]
) -> None:
    from mjgranular.picture.figures import draw_motion

    stop = release_to_stop(summary)
    folder.write(name, lambda path: draw_motion(path, trajectory, stop=stop, title=title(summary)))


def film_impact(
    folder: ResultFolder,
    name: str,
    impact: Impact,
    trajectory: Trajectory,
    summary: dict[str, Any],
    film: Film,
    prints: Tracks | None = None,
) -> None:
    """Film a drop."""
    from mjgranular.picture.video import frames_of_run

    stop = release_to_stop(summary)
    write_film(
        folder,
        name,
        film,
        lambda: frames_of_run(
            film, impact.link, trajectory, stop=stop, prints=prints, sand=impact.described
        ),
    )
