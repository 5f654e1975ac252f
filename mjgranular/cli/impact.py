"""`mjgranular impact`: one drop of the link or of another body."""

from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

from rich.table import Table

from mjgranular._util.result_folder import ResultFolder
from mjgranular.cli.console import note, out, print_result, progress_bar
from mjgranular.cli.options import FilmOptions, collected, options_of, write_film
from mjgranular.errors import GranularError, InputError
from mjgranular.experiment import Impact, ImpactResult, run_impact
from mjgranular.experiment.folder import RUN_FILES, write_run
from mjgranular.picture.figures import draw_forces, draw_motion
from mjgranular.picture.video import Film, check_camera, frames_of_impact

FIGURES = ("motion.png", "forces.png")
VIDEO = "impact.mp4"


@dataclass(frozen=True, kw_only=True)
class ImpactCommand(FilmOptions, options_of(Impact)):
    """Drop the link onto sand: its end T meets the sand and stops.

    Prints stopping time and depth. With --out DIR, writes trajectory, summary, configuration and
    figures there; with --video, a film too.
    """

    def run(self) -> int:
        self.check_film()
        if self.body == "sphere" and self.length != Impact.length:
            raise InputError("a sphere has no --length: its size is its --diameter")
        impact = self.experiment()
        film = Film(camera=self.camera or "side") if self.video else None
        if film is not None:
            check_camera(impact.link.spec().compile(), film.camera)
        # The law may be None here, and is named in the file.
        config = {name: value for name, value in asdict(impact).items() if name != "law" or value}
        with self.claimed(*RUN_FILES, *FIGURES, VIDEO, command="impact", config=config) as folder:
            with progress_bar("dropping the link", impact.duration) as progress:
                result = run_impact(impact, progress=progress)
            if folder is not None:
                write_run(folder, result)
            print_result(result.summary(), partial(_show, result), json=self.json)
            problems = [] if folder is None else _draw(folder, result, film)
            if folder is not None and not problems:
                folder.finish()
        return self.finish(problems)


_ROWS = (
    ("timestep", "time step", 1, "s"),
    ("speed", "speed of T", 1, "m/s"),
    ("angle_deg", "angle from the vertical", 1, "deg"),
    ("tangential_speed", "tangential speed of T", 1, "m/s"),
    ("angular_velocity", "angular velocity", 1, "rad/s"),
    ("height", "height of release", 1, "m"),
    ("stopping_time", "stopping time", 1e3, "ms"),
    ("depth", "depth of T", 1e3, "mm"),
    ("stop_angle_deg", "angle at the stop", 1, "deg"),
    ("stop_angular_velocity", "angular velocity at the stop", 1, "rad/s"),
    ("greatest_force", "greatest force of the sand", 1, "N"),
    ("rest_time", "at rest after", 1e3, "ms"),
    ("rest_depth", "depth of the lowest point at rest", 1e3, "mm"),
    ("rest_angle_deg", "angle at rest", 1, "deg"),
)
"""Rows of the table: name in the summary, words, factor, unit."""


def _show(result: ImpactResult) -> None:
    """Print a drop as a table, without what is zero or unknown, and remarks on it."""
    summary, impact = result.summary(), result.impact
    shown = Table(title=f"Impact on sand: {impact.body}", show_header=False, title_justify="left")
    for justify in ("left", "right", "left"):
        shown.add_column(justify=justify, style="dim" if justify == "left" else "")
    shown.add_row("sand, law, scheme", f"{impact.medium}, {result.law}, {impact.scheme_taken}", "")
    for key, words, factor, unit in _ROWS:
        if summary[key]:
            shown.add_row(words, f"{summary[key] * factor:.5g}", unit)
    out.print(shown)
    if result.stop is None:
        note(f"T did not stop within {impact.duration:g} s; a longer --duration may show it")
    elif impact.until == "rest" and result.rest is None:
        omega = float(result.trajectory.omega[-1])
        note(f"not at rest after {impact.duration:g} s: it turns at {omega:.1f} rad/s")


def release_to_stop(summary: dict[str, Any]) -> float | None:
    """Return the time from release to the stop [s]; None without a stop."""
    if summary["stopping_time"] is None:
        return None
    return summary["touchdown_time"] + summary["stopping_time"]


def _draw(folder: ResultFolder, result: ImpactResult, film: Film | None) -> list[GranularError]:
    """Draw the figures of a drop and its film; return what could not be drawn."""
    problems: list[GranularError] = []
    summary = result.summary()
    stop = release_to_stop(summary)
    title = (
        f"{summary['speed']:g} m/s, {summary['angle_deg']:g} deg, {summary['medium']}, "
        f"{summary['law']} law, {summary['scheme']}, {summary['timestep']:g} s"
    )
    with collected(problems):
        options = {"stop": stop, "title": title}
        for name, draw in zip(FIGURES, (draw_motion, draw_forces), strict=True):
            folder.write(name, lambda path, draw=draw: draw(path, result.trajectory, **options))
    if film is not None:
        drawn = (film, result.impact, result.trajectory, stop, result.prints)
        with collected(problems):
            write_film(folder, VIDEO, film, frames_of_impact(*drawn))
    return problems
