"""`mjgranular impact`: one drop."""

from __future__ import annotations

import math
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from rich.table import Table

from mjgranular.cli.console import err, out, print_json, progress_bar, show_error
from mjgranular.cli.filming import write_film
from mjgranular.cli.options import LinkOptions
from mjgranular.errors import GranularError, InputError, MissingExtraError
from mjgranular.experiment import DropResult, Impact, ImpactResult, run_drop, run_impact
from mjgranular.experiment.chain_impact import chain_drop, chain_length, chain_summary
from mjgranular.experiment.folder import RUN_FILES, ResultFolder, write_drop, write_impact
from mjgranular.experiment.slips import warn_of_slips
from mjgranular.experiment.trajectory import Trajectory
from mjgranular.models import Link
from mjgranular.prints import Prints
from mjgranular.relief.memory import as_memory
from mjgranular.sand.prepare import fitted

if TYPE_CHECKING:
    from mjgranular.picture.video import Film

FIGURES = ("motion.png", "forces.png")
PROFILE = "prints.png"
VIDEO = "impact.mp4"


@dataclass(frozen=True)
class ImpactCommand(LinkOptions):
    """One drop: the link meets the sand, and its end T stops.

    Prints stopping time and depth. With --out DIR, writes trajectory, summary, configuration and
    figures there; with --video, a film too.
    """

    body: Annotated[str, tyro.conf.arg(metavar="SHAPE")] = "link"
    """What falls: link, sphere, box, cylinder, capsule, ellipsoid, plate, or chain:N."""
    speed: Annotated[float, tyro.conf.arg(metavar="M/S")] = 10.0
    """Velocity of the lower end T at release, down [m/s]."""
    angle: Annotated[float, tyro.conf.arg(metavar="DEG")] = 45.0
    """Angle of the link from the vertical [degrees]."""
    until: Literal["stop", "rest"] = "stop"
    """End when T stops, or when the whole link is at rest (try --law link_distributed)."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder for the results; nothing is written without it."""
    video: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Write a film of the impact into the folder."""
    camera: Annotated[str, tyro.conf.arg(metavar="NAME")] = "side"
    """Camera of the film: side, close or corner."""
    overwrite: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Replace a result that the folder holds already."""
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print one JSON object instead of a table."""

    def run(self) -> int:
        """Runs the command."""
        self._check_options()
        count = chain_length(self.body)
        if count is not None:
            return self._run_chain(count)
        impact = self.impact(
            speed=self.speed, angle_deg=self.angle, until=self.until, body=self.body
        )
        if self.video and self.out is None:
            raise InputError("--video needs a folder to write to: add --out DIR")
        if self.out is None:
            self._show(self._drop(impact))
            return 0
        film = self._film(impact.link) if self.video else None
        names = (*RUN_FILES, *FIGURES, PROFILE, VIDEO)
        with ResultFolder(self.out, names).claimed(overwrite=self.overwrite) as folder:
            result = self._drop(impact)
            write_impact(folder, result)
            self._show(result)
            problems = draw_impact(folder, result.trajectory, result.summary())
            if result.prints is not None:
                problems += draw_profile(folder, impact, result.prints, result.summary())
            if film is not None:
                problems += film_impact(
                    folder, VIDEO, impact, result.trajectory, result.summary(), film, result.prints
                )
        if not self.json:
            out.print(f"written to {self.out}", highlight=False, markup=False)
        for problem in problems:
            show_error(f"{problem} (the numbers are in {self.out})")
        return 2 if problems else 0

    def _check_options(self) -> None:
        """Refuses options that would be left aside without a word."""
        if self.body == "sphere" and self.length != LinkOptions.length:
            raise InputError("a sphere has no --length: its size is its --diameter")
        if chain_length(self.body) is not None and self.until != "stop":
            raise InputError("--until is for one body: a chain is followed for its --duration")
        if self.camera != "side" and not self.video:
            raise InputError("--camera is for a film: add --video")

    def _run_chain(self, count: int) -> int:
        """Drops a chain of so many links."""
        from mjgranular.cli import drop as models
        from mjgranular.experiment.drop import load

        impact = self.impact(speed=self.speed, angle_deg=self.angle)
        if self.video and self.out is None:
            raise InputError("--video needs a folder to write to: add --out DIR")
        drop = chain_drop(impact, count)
        if self.video:
            from mjgranular.picture.video import check_camera

            check_camera(load(drop)[0], self.camera)
        warn_of_slips(
            lengths={"the height of release": self.height}, speed=self.speed, density=self.density
        )
        names = (*RUN_FILES, models.FIGURE, models.FILM)
        folder = None if self.out is None else ResultFolder(self.out, names)
        problems: list[GranularError] = []
        with nullcontext() if folder is None else folder.claimed(overwrite=self.overwrite):
            with progress_bar("dropping the chain", drop.duration) as progress:
                result = run_drop(drop, progress=progress)
            if folder is not None:
                write_drop(folder, result)
            self._show_chain(impact, count, result)
            if folder is not None:
                problems += models.draw(folder, result)
                if self.video:
                    problems += models.film(folder, result, self.camera)
        for problem in problems:
            show_error(f"{problem} (the numbers are in {self.out})")
        return 2 if problems else 0

    def _show_chain(self, impact: Impact, count: int, result: DropResult) -> None:
        from mjgranular.cli import drop as models

        if self.json:
            print_json(chain_summary(impact, count, result))
            return
        models.show(result)
        if result.stop is None:
            out.print(f"T, the end of the last link, did not stop within {impact.duration:g} s")
        else:
            time, depth = result.stop
            out.print(
                f"T, the end of the last link, stops after {time * 1e3:.3f} ms, "
                f"{depth * 1e3:.3f} mm deep",
                highlight=False,
            )

    def _film(self, link: Link) -> Film:
        from mjgranular.picture.video import Film

        film = Film(camera=self.camera)
        film.check(link)
        return film

    def _drop(self, impact: Impact) -> ImpactResult:
        with progress_bar("dropping the link", impact.duration) as progress:
            return run_impact(impact, progress=progress)

    def _show(self, result: ImpactResult) -> None:
        if self.json:
            print_json(result.summary())
        else:
            out.print(impact_table(result))
            for line in remarks(result):
                err.print(line, highlight=False, markup=False)


def impact_table(result: ImpactResult) -> Table:
    """The result as a table for a person."""
    summary = result.summary()
    impact = result.impact
    table = Table(
        title=f"Impact on sand: {result.impact.body}", show_header=False, title_justify="left"
    )
    table.add_column(style="dim")
    table.add_column(justify="right")
    table.add_column(style="dim")

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
    """Notes for a person beside the numbers."""
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
    """Time from release to the stop [s], None if there was none."""
    if summary["stopping_time"] is None:
        return None
    return summary["touchdown_time"] + summary["stopping_time"]


def title(summary: dict[str, Any]) -> str:
    """A line above figures."""
    return (
        f"{summary['speed']:g} m/s, {summary['angle_deg']:g} deg, {summary['medium']}, "
        f"{summary['law']} law, {summary['scheme']}, {summary['timestep']:g} s"
    )


def draw_impact(
    folder: ResultFolder, trajectory: Trajectory, summary: dict[str, Any]
) -> list[GranularError]:
    """Draws the figures of a drop; returns what kept it from doing so."""
    from mjgranular.picture.figures import draw_forces, draw_motion

    stop = release_to_stop(summary)
    try:
        for name, draw in zip(FIGURES, (draw_motion, draw_forces), strict=True):
            folder.write(
                name,
                lambda path, draw=draw: draw(path, trajectory, stop=stop, title=title(summary)),
            )
    except MissingExtraError as error:
        return [error]
    return []


def draw_profile(
    folder: ResultFolder, impact: Impact, prints: Prints, summary: dict[str, Any]
) -> list[GranularError]:
    """Draws the sand as the run has left it; returns what kept it from doing so."""
    from mjgranular.picture.figures import draw_prints

    memory = as_memory(fitted(impact.link.model(impact.timestep), impact.described).memory)
    assert memory is not None
    places, heights = prints.profile(memory)
    try:
        folder.write(PROFILE, lambda path: draw_prints(path, places, heights, title=title(summary)))
    except MissingExtraError as error:
        return [error]
    return []


def film_impact(
    folder: ResultFolder,
    name: str,
    impact: Impact,
    trajectory: Trajectory,
    summary: dict[str, Any],
    film: Film,
    prints: Prints | None = None,
) -> list[GranularError]:
    """Films a drop; returns what kept it from doing so."""
    from mjgranular.picture.video import frames_of_run

    stop = release_to_stop(summary)
    return write_film(
        folder,
        name,
        film,
        lambda: frames_of_run(
            film, impact.link, trajectory, stop=stop, prints=prints, sand=impact.described
        ),
    )
