"""`mjgranular impact`: one drop of the link, of another body or of a chain; the paper's table."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from rich.table import Table

from mjgranular._util.result_folder import ResultFolder
from mjgranular.cli.console import note, out, print_json, progress_bar
from mjgranular.cli.options import options_of, record_of
from mjgranular.cli.results import FilmOptions, collected, write_film
from mjgranular.errors import GranularError, InputError
from mjgranular.experiment import Impact, ImpactResult, run_impact
from mjgranular.experiment.folder import RUN_FILES, write_impact
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
class ImpactCommand(FilmOptions, options_of(Impact)):
    """Drop the link onto sand: its end T meets the sand and stops.

    Prints stopping time and depth. With --out DIR, writes trajectory, summary, configuration and
    figures there; with --video, a film too.
    """

    def run(self) -> int:
        """Run the command."""
        self.check_film()
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
                _show(result)
            problems = [] if folder is None else _draw(folder, result, film)
        return self.finish(problems)

    def experiment(self) -> Impact:
        """Return the experiment."""
        return record_of(Impact, self)

    def _film(self, impact: Impact) -> Film:
        from mjgranular.picture.video import Film

        film = Film(camera=self.camera or "side")
        film.check(impact.link)
        return film


def _show(result: ImpactResult) -> None:
    """Print a drop as a table, and remarks on it."""
    summary, impact, stop, rest = result.summary(), result.impact, result.stop, result.rest
    rows: list[tuple[str, str, str] | None] = [  # None for a line
        ("sand, law, scheme", f"{impact.medium}, {result.law}, {impact.scheme_taken}", ""),
        ("time step", f"{impact.timestep:g}", "s"),
        ("speed of T", f"{impact.speed:g}", "m/s"),
        ("angle from the vertical", f"{summary['angle_deg']:g}", "deg"),
    ]
    for name, value, unit in (
        ("tangential speed of T", impact.tangential_speed, "m/s"),
        ("angular velocity", impact.angular_velocity, "rad/s"),
        ("height of release", impact.height, "m"),
    ):
        if value:
            rows.append((name, f"{value:g}", unit))
    rows.append(None)
    if stop is None:
        rows.append(("stopping time", f"not within {impact.duration:g}", "s"))
        rows.append(("greatest depth of T", f"{summary['depth'] * 1e3:.3f}", "mm"))
    else:
        rows += [
            ("stopping time", f"{stop.time * 1e3:.3f}", "ms"),
            ("depth of T at the stop", f"{stop.depth * 1e3:.3f}", "mm"),
            ("angle at the stop", f"{math.degrees(stop.angle):.2f}", "deg"),
            ("angular velocity at the stop", f"{stop.angular_velocity:.2f}", "rad/s"),
        ]
    rows.append(("greatest force of the sand", f"{summary['greatest_force']:.1f}", "N"))
    if rest is not None:
        rows += [
            ("at rest after", f"{rest.time * 1e3:.1f}", "ms"),
            ("depth of the deeper end at rest", f"{rest.depth * 1e3:.3f}", "mm"),
            ("angle at rest", f"{math.degrees(rest.angle):.2f}", "deg"),
        ]
    shown = Table(title=f"Impact on sand: {impact.body}", show_header=False, title_justify="left")
    for justify in ("left", "right", "left"):
        shown.add_column(justify=justify, style="dim" if justify == "left" else "")
    for row in rows:
        shown.add_section() if row is None else shown.add_row(*row)
    out.print(shown)
    if stop is None:
        note(f"T did not stop within {impact.duration:g} s; a longer --duration may show it")
    elif impact.until == "rest" and rest is None:
        omega = float(result.trajectory.omega[-1])
        line = f"not at rest after {impact.duration:g} s: it turns at {omega:.1f} rad/s"
        if result.law.split()[0] == "link":
            line += "; the lumped law does not resist turning about E, --law link_distributed does"
        note(line)


def release_to_stop(summary: dict[str, Any]) -> float | None:
    """Return the time from release to the stop [s]; None without a stop."""
    if summary["stopping_time"] is None:
        return None
    return summary["touchdown_time"] + summary["stopping_time"]


def _title(summary: dict[str, Any]) -> str:
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
    stop, above = release_to_stop(summary), _title(summary)
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
    folder.write(name, lambda path: draw_motion(path, trajectory, stop=stop, title=_title(summary)))


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

    options = {"stop": release_to_stop(summary), "prints": prints, "sand": impact.described}
    frames = partial(frames_of_run, film, impact.link, trajectory, **options)
    write_film(folder, name, film, frames)
