"""`mjgranular drop`: your own model on sand."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mjgranular.cli.console import out, print_json, progress_bar, table
from mjgranular.cli.filming import write_film
from mjgranular.cli.options import options_of, record_of
from mjgranular.cli.results import FilmOptions, collected, note
from mjgranular.errors import GranularError, GranularWarning
from mjgranular.experiment.drop import Drop, DropResult, load, memory_of, run_drop, surface_drawn
from mjgranular.experiment.folder import RUN_FILES, ResultFolder, write_drop

FIGURE = "drop.png"
FILM = "drop.mp4"


@dataclass(frozen=True, kw_only=True)
class DropCommand(FilmOptions, options_of(Drop, without=("model", "state", "site"))):
    """Drop your MJCF model onto sand, throw it at the sand, or let it stand there.

    Prints for each body the greatest depth and force, the energy it gave to the sand, and whether
    the law held. With --out DIR, writes samples, summary, configuration and a figure there; with
    --video, a film too.
    """

    model: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL.xml")]
    """The MJCF file, or a robot of MuJoCo Menagerie by its name, such as unitree_go1."""

    def run(self) -> int:
        """Run the command."""
        drop = self.experiment()
        check_film(self, drop)
        with self.claimed(*RUN_FILES, FIGURE, FILM) as folder:
            with progress_bar("running the model", drop.duration) as progress:
                result = run_drop(drop, progress=progress)
            if folder is not None:
                write_drop(folder, result)
            if self.json:
                print_json(result.summary())
            else:
                show(result)
            problems = [] if folder is None else draw(self, folder, result)
        return self.finish(problems)

    def experiment(self) -> Drop:
        """Return what is asked for."""
        return record_of(Drop, self)


def check_film(options: FilmOptions, drop: Drop) -> None:
    """Raise if a film is asked for that cannot be made."""
    options.check_film()
    if options.video:
        from mjgranular.picture.video import check_camera

        check_camera(load(drop)[0], options.camera or "free")


def draw(options: FilmOptions, folder: ResultFolder, result: DropResult) -> list[GranularError]:
    """Draw the figure of a run, and with `--video` its film; return what could not be drawn."""
    from mjgranular.picture.figures import draw_drop

    problems: list[GranularError] = []
    names = [body.body for body in result.bodies]
    title = f"{result.drop.title}, {result.medium}, {result.law} law, {result.timestep:g} s"
    with collected(problems):
        folder.write(
            FIGURE,
            lambda path: draw_drop(
                path, result.t, names, result.depth, result.force, result.power, title=title
            ),
        )
    if options.video:
        with collected(problems):
            _film(folder, result, options.camera or "free")
    return problems


def _film(folder: ResultFolder, result: DropResult, camera: str) -> None:
    from mjgranular.picture.video import Film, Motion, frames_of_model

    options = Film(camera=camera, seconds=1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GranularWarning)  # which the run has given
        model, _ = load(result.drop)
    motion = Motion(result.t, result.qpos, result.point, result.force)
    surface, memory = surface_drawn(result.drop), memory_of(result.drop, model)
    write_film(
        folder,
        FILM,
        options,
        lambda: frames_of_model(options, model, motion, surface, result.prints, memory),
    )


def show(result: DropResult) -> None:
    """Print a run as a table."""
    title = (
        f"{result.drop.title} on {result.medium}: {result.law} law, {result.elements} elements, "
        f"{result.t[-1]:g} s in steps of {result.timestep:g} s"
    )
    headings = ("body", "depth\n[mm]", "force\n[N]", "energy into\nsand [J]", "law held")
    rows = []
    for body in result.bodies:
        held = body.within_validity
        depth = "not met" if held is None else f"{body.greatest_depth * 1e3:.2f}"
        share = "" if held is None else f"{held:.0%}"
        energy = f"{body.energy_into_sand + 0.0:.3g}"
        rows.append((body.body, depth, f"{body.greatest_force:.3g}", energy, share))
    out.print(table(title, headings, rows))
    if result.rest is not None:
        out.print(f"at rest after {result.rest:.3f} s", highlight=False)
    for body in result.bodies:
        for measure, value in body.exceeded.items():
            note(f"{body.body}: {measure} reached {value:.3g}, outside the validity of the law")
