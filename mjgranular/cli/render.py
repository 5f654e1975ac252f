"""`mjgranular render`: a film of a saved run."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mjgranular._util.checks import check_count
from mjgranular._util.result_folder import TRAINING, ResultFolder
from mjgranular.cli import drop, impact
from mjgranular.cli.console import out
from mjgranular.cli.evaluate import find_actor, is_environment
from mjgranular.cli.options import Flag, options_of, write_film
from mjgranular.errors import InputError
from mjgranular.experiment.folder import prints_of, read_drop, read_impact, saved_command
from mjgranular.learn.evaluate import FIRST_SEED
from mjgranular.learn.film import frames_of_episode
from mjgranular.learn.policies import shipped_policies
from mjgranular.picture.video import Film, Frames, frames_of_drop, frames_of_impact

_DEFAULT_FILES = {"impact": impact.VIDEO, "drop": drop.FILM, TRAINING: "policy.mp4"}


@dataclass(frozen=True)
class RenderCommand(options_of(Film, "seconds", "width", "height", "fps")):
    """A film of a run saved with `mjgranular impact --out`, `drop --out`, or of `train`.

    Of a drop the sand's force is drawn as an arrow, and the film is slowed down so that the impact,
    however short, takes --seconds. Of a training run the newest policy is filmed in an episode, in
    real time, for --seconds at most.
    """

    run_folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR", name="run")]
    """Folder of the saved drop or of the training run."""
    camera: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None
    """Camera: of the link side, close or corner; of other models theirs, or free."""
    on: Annotated[str, tyro.conf.arg(metavar="NAME=VALUE,...")] = ""
    """Of a training run: a variant of its environment, for example medium=glass_beads."""
    seed: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Of a training run: the seed of the episode."""
    trust: Flag = False
    """Import and so execute the module of an environment that only the run's file names."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE.mp4")] = None
    """The file. Default: impact.mp4, drop.mp4 or policy.mp4 in the folder of the run."""
    overwrite: Flag = False
    """Replace a film that exists."""

    def run(self) -> int:
        command = self._command()
        draws = {"impact": self._impact, "drop": self._model, TRAINING: self._policy}
        if command not in draws:
            raise InputError(
                f"a film is of an impact, drop or training run; {self.run_folder} is of '{command}'"
            )
        target = self.out or self.run_folder / _DEFAULT_FILES[command]
        if target.suffix.lower() != ".mp4":
            raise InputError(f"a film must be written as .mp4, got {target.name!r}")
        if command != TRAINING and (self.on or self.seed is not None):
            raise InputError(f"--on and --seed are for training runs, got {self.run_folder}")
        if self.seed is not None:
            check_count("seed", self.seed, least=0)
        camera = self.camera or ("side" if command == "impact" else "free")
        film, frames = draws[command](self.experiment(camera=camera))
        folder = ResultFolder(target.parent, (target.name,))
        with folder.claimed(overwrite=self.overwrite):
            write_film(folder, target.name, film, frames)
        out.print(f"written to {target}")
        return 0

    def _command(self) -> str:
        """Return the command whose result the folder holds; it may also be a policy's name."""
        what = self.run_folder.as_posix()
        if not self.run_folder.exists() and what in shipped_policies():
            if self.out is None:
                raise InputError(f"a film of {what} needs a file to write to: add --out FILE")
            return TRAINING
        if is_environment(what):
            raise InputError(
                f"{what} is an environment; a film is made of a run of mjgranular train {what}, or "
                "of a policy that `mjgranular list policies` lists"
            )
        return saved_command(self.run_folder)

    def _impact(self, film: Film) -> tuple[Film, Frames]:
        experiment, summary, trajectory, prints = read_impact(self.run_folder)
        stop = impact.release_to_stop(summary)
        return film, frames_of_impact(film, experiment, trajectory, stop, prints)

    def _model(self, film: Film) -> tuple[Film, Frames]:
        experiment, arrays = read_drop(self.run_folder)
        return film, frames_of_drop(film, experiment, arrays, prints_of(arrays))

    def _policy(self, film: Film) -> tuple[Film, Frames]:
        actor = find_actor(str(self.run_folder), trust=self.trust)
        film, count, frames = frames_of_episode(
            actor.environment,
            actor.arguments_on(self.on),
            actor.make,
            film,
            seed=FIRST_SEED if self.seed is None else self.seed,
            camera=self.camera,
        )
        return film, (count, frames)
