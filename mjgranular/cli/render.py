"""`mjgranular render`: a film of a saved run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mjgranular.cli.console import out
from mjgranular.cli.impact import VIDEO, film_impact
from mjgranular.errors import InputError
from mjgranular.experiment.folder import ResultFolder, read_impact


@dataclass(frozen=True)
class RenderCommand:
    """A film of a drop that was saved with `mjgranular impact --out DIR`.

    The sand's force is drawn as an arrow. The film is slowed so that the impact, however short,
    takes --seconds.
    """

    run_folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR", name="run")]
    """Folder of the saved drop."""
    camera: Annotated[str, tyro.conf.arg(metavar="NAME")] = "side"
    """Camera: side, close or corner."""
    seconds: Annotated[float, tyro.conf.arg(metavar="S")] = 5.0
    """Length of the film from release to the stop [s]; what follows takes as long again."""
    width: Annotated[int, tyro.conf.arg(metavar="PIXELS")] = 800
    """Width of the picture."""
    height: Annotated[int, tyro.conf.arg(metavar="PIXELS")] = 600
    """Height of the picture."""
    fps: Annotated[int, tyro.conf.arg(metavar="N")] = 30
    """Frames a second."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE.mp4")] = None
    """The file. Default: impact.mp4 in the folder of the drop."""
    overwrite: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Replace a film that is there already."""

    def run(self) -> int:
        """Runs the command."""
        from mjgranular.picture.video import Film

        target = self.run_folder / VIDEO if self.out is None else self.out
        if target.suffix != ".mp4":
            raise InputError(f"a film is written as .mp4, not {target.suffix or target.name!r}")
        film = {
            "camera": self.camera,
            "seconds": self.seconds,
            "width": self.width,
            "height": self.height,
            "fps": self.fps,
        }
        impact, summary, trajectory = read_impact(self.run_folder)
        Film(**film).check(impact.link)
        folder = ResultFolder(target.parent, (target.name,))
        with folder.claimed(overwrite=self.overwrite):
            problems = film_impact(folder, target.name, impact.link, trajectory, summary, **film)
        if problems:
            raise problems[0]
        out.print(f"written to {target}", highlight=False, markup=False)
        return 0
