"""`mjgranular drop`: your own model on sand."""

from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro

from mjgranular._util.result_folder import ResultFolder
from mjgranular.cli.console import note, out, print_result, progress_bar, table
from mjgranular.cli.options import FilmOptions, collected, options_of, write_film
from mjgranular.errors import GranularError
from mjgranular.experiment.drop import Drop, DropResult, load, run_drop
from mjgranular.experiment.folder import RUN_FILES, write_run
from mjgranular.picture.elements import count
from mjgranular.picture.figures import draw_drop
from mjgranular.picture.video import Film, check_camera, frames_of_drop

FIGURE = "drop.png"
FILM = "drop.mp4"


@dataclass(frozen=True, kw_only=True)
class DropCommand(FilmOptions, options_of(Drop, without=("model",))):
    """Drop your MJCF model onto sand, throw it at the sand, or let it stand there.

    Prints for each body the greatest depth and force, the energy it gave to the sand, and whether
    the law held. With --out DIR, writes samples, summary, configuration and a figure there; with
    --video, a film too.
    """

    model: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL.xml")]
    """The MJCF file, or a robot of MuJoCo Menagerie by its name, such as unitree_go1."""

    def run(self) -> int:
        self.check_film()
        drop, camera = self.experiment(), self.camera or "free"
        if self.video and self.camera is not None:
            check_camera(load(drop)[0], camera)
        problems: list[GranularError] = []
        with self.claimed(*RUN_FILES, FIGURE, FILM, command="drop", config=asdict(drop)) as folder:
            with progress_bar("running the model", drop.duration) as progress:
                result = run_drop(drop, progress=progress)
            if folder is not None:
                write_run(folder, result)
            print_result(result.summary(), partial(_show, result), json=self.json)
            if folder is not None:
                with collected(problems):
                    _draw(folder, result)
                if self.video:
                    film = Film(camera=camera, seconds=1.0)
                    drawn = (film, drop, vars(result), result.prints)
                    with collected(problems):
                        write_film(folder, FILM, film, frames_of_drop(*drawn))
                if not problems:
                    folder.finish()
        return self.finish(problems)


def _draw(folder: ResultFolder, result: DropResult) -> None:
    names = [body.body for body in result.bodies]
    title = f"{result.drop.title}, {result.medium}, {result.law} law, {result.timestep:g} s"
    arrays = result.t, names, result.depth, result.force, result.power
    folder.write(FIGURE, lambda path: draw_drop(path, *arrays, title=title))


def _show(result: DropResult) -> None:
    number = count(result.elements, "elements")
    title = (
        f"{result.drop.title} on {result.medium}: {result.law} law, {number}, "
        f"{result.t[-1]:g} s in steps of {result.timestep:g} s"
    )
    headings = ("body", "depth\n[mm]", "force\n[N]", "energy into\nsand [J]", "law held")
    rows = []
    for body in result.bodies:
        depth = f"{body.greatest_depth * 1e3:.2f}" if body.greatest_depth > 0 else "not met"
        share = "" if (held := body.within_validity) is None else f"{held:.0%}"
        energy = f"{body.energy_into_sand + 0.0:.3g}"
        rows.append((body.body, depth, f"{body.greatest_force:.3g}", energy, share))
    out.print(table(title, headings, rows))
    if result.rest is not None:
        out.print(f"at rest after {result.rest:.3f} s")
    for body in result.bodies:
        for measure, value in body.exceeded.items():
            note(f"{body.body}: {measure} reached {value:.3g}, outside the validity of the law")
