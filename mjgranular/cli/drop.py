"""`mjgranular drop`: a model of one's own on sand."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mjgranular.cli.console import err, out, print_json, progress_bar, show_error, table
from mjgranular.cli.filming import write_film
from mjgranular.cli.options import SandOptions, record_of
from mjgranular.errors import GranularError, GranularWarning, InputError, MissingExtraError
from mjgranular.experiment.drop import Drop, DropResult, load, memory_of, run_drop, surface_drawn
from mjgranular.experiment.folder import RUN_FILES, ResultFolder, write_drop

FIGURE = "drop.png"
FILM = "drop.mp4"


@dataclass(frozen=True)
class DropCommand(SandOptions):
    """Your own MJCF model falls onto sand, is thrown at it or stands on it.

    Prints for each body the greatest depth and force, the energy it gave to the sand, and whether
    the law held. With --out DIR, writes samples, summary, configuration and a figure there; with
    --video, a film too.
    """

    model: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL.xml")]
    """The MJCF file."""
    keyframe: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None
    """Keyframe of the model to start from."""
    height: Annotated[float | None, tyro.conf.arg(metavar="M")] = None
    """Height of the lowest point above the surface at the start [m]. Default: as the model is."""
    velocity: Annotated[float, tyro.conf.arg(metavar="M/S")] = 0.0
    """Velocity at the start, down [m/s]."""
    duration: Annotated[float, tyro.conf.arg(metavar="S")] = 1.0
    """Simulated time [s]."""
    timestep: Annotated[float | None, tyro.conf.arg(metavar="S")] = None
    """Time step [s]. Default: the model's, at most 1e-4 s with the explicit scheme."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder for the results; nothing is written without it."""
    video: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Write a film into the folder."""
    camera: Annotated[str, tyro.conf.arg(metavar="NAME")] = "free"
    """Camera of the film: one of the model's, or free."""
    overwrite: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Replace a result that the folder holds already."""
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print one JSON object instead of a table."""

    def run(self) -> int:
        """Runs the command."""
        drop = record_of(Drop, self)
        if self.video and self.out is None:
            raise InputError("--video needs a folder to write to: add --out DIR")
        if self.video:
            from mjgranular.picture.video import check_camera

            check_camera(load(drop)[0], self.camera)
        elif self.camera != "free":
            raise InputError("--camera is for a film: add --video")
        if self.out is None:
            self._show(self._run(drop))
            return 0
        names = (*RUN_FILES, FIGURE, FILM)
        with ResultFolder(self.out, names).claimed(overwrite=self.overwrite) as folder:
            result = self._run(drop)
            write_drop(folder, result)
            self._show(result)
            problems = draw(folder, result)
            if self.video:
                problems += film(folder, result, self.camera)
        if not self.json:
            out.print(f"written to {self.out}", highlight=False, markup=False)
        for problem in problems:
            show_error(f"{problem} (the numbers are in {self.out})")
        return 2 if problems else 0

    def _run(self, drop: Drop) -> DropResult:
        with progress_bar("running the model", drop.duration) as progress:
            return run_drop(drop, progress=progress)

    def _show(self, result: DropResult) -> None:
        if self.json:
            print_json(result.summary())
        else:
            show(result)


def draw(folder: ResultFolder, result: DropResult) -> list[GranularError]:
    """Draws the figure of a run; returns what kept it from doing so."""
    from mjgranular.picture.figures import draw_drop

    names = [body.body for body in result.bodies]
    title = f"{result.drop.title}, {result.medium}, {result.law} law, {result.timestep:g} s"
    try:
        folder.write(
            FIGURE,
            lambda path: draw_drop(
                path, result.t, names, result.depth, result.force, result.power, title=title
            ),
        )
    except MissingExtraError as error:
        return [error]
    return []


def film(folder: ResultFolder, result: DropResult, camera: str) -> list[GranularError]:
    """Films a run; returns what kept it from doing so."""
    from mjgranular.picture.video import Film, Motion, frames_of_model

    options = Film(camera=camera, seconds=1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GranularWarning)  # which the run has given
        model, _ = load(result.drop)
    motion = Motion(result.t, result.qpos, result.point, result.force)
    return write_film(
        folder,
        FILM,
        options,
        lambda: frames_of_model(
            options,
            model,
            motion,
            surface_drawn(result.drop),
            result.prints,
            memory_of(result.drop, model),
        ),
    )


def show(result: DropResult) -> None:
    """Prints a run as a table."""
    title = (
        f"{result.drop.title} on {result.medium}: {result.law} law, {result.elements} "
        f"elements, {result.t[-1]:g} s in steps of {result.timestep:g} s"
    )
    headings = ("body", "depth\n[mm]", "force\n[N]", "energy into\nsand [J]", "law held")
    cells = [
        (
            body.body,
            "not met" if body.within_validity is None else f"{body.greatest_depth * 1e3:.2f}",
            f"{body.greatest_force:.3g}",
            f"{body.energy_into_sand + 0.0:.3g}",
            "" if body.within_validity is None else f"{body.within_validity:.0%}",
        )
        for body in result.bodies
    ]
    out.print(table(title, headings, cells))
    if result.rest is not None:
        out.print(f"at rest after {result.rest:.3f} s", highlight=False)
    for body in result.bodies:
        for measure, value in body.exceeded.items():
            err.print(
                f"{body.body}: {measure} reached {value:.3g}, outside the validity of the law",
                highlight=False,
                markup=False,
            )
