"""`mjgranular render`: a film of a saved run."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from mjgranular._util.result_folder import ResultFolder
from mjgranular.cli.console import out, progress_bar
from mjgranular.cli.drop import FILM
from mjgranular.cli.filming import write_film
from mjgranular.cli.impact import VIDEO, film_impact
from mjgranular.errors import (
    GranularWarning,
    InputError,
    OutputError,
    warn_user,
)
from mjgranular.experiment.drop import load, memory_of, surface_drawn
from mjgranular.experiment.folder import (
    prints_of,
    read_drop,
    read_impact,
    read_prints,
    saved_command,
)
from mjgranular.models import Chain

if TYPE_CHECKING:
    from mjgranular.picture.video import Film

POLICY_FILM = "policy.mp4"

Draw = Callable[[ResultFolder, str], None]


@dataclass(frozen=True)
class RenderCommand:
    """A film of a run saved with `mjgranular impact --out`, `drop --out`, or of `train`.

    Of a drop the sand's force is drawn as an arrow, and the film is slowed so that the impact,
    however short, takes --seconds. Of a training run the newest policy is filmed in an episode, in
    real time, for --seconds at most.
    """

    run_folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR", name="run")]
    """Folder of the saved drop or of the training run."""
    camera: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None
    """Camera: of the link side, close or corner; of other models theirs, or free."""
    seconds: Annotated[float, tyro.conf.arg(metavar="S")] = 5.0
    """Length of the film from release to the stop [s]; what follows takes as long again."""
    width: Annotated[int, tyro.conf.arg(metavar="PIXELS")] = 640
    """Width of the picture."""
    height: Annotated[int, tyro.conf.arg(metavar="PIXELS")] = 480
    """Height of the picture."""
    fps: Annotated[int, tyro.conf.arg(metavar="N")] = 30
    """Frames a second."""
    on: Annotated[str, tyro.conf.arg(metavar="NAME=VALUE,...")] = ""
    """Of a training run: a variant of its environment, for example medium=glass_beads."""
    seed: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Of a training run: the seed of the episode."""
    trust: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Import the module of an environment that only the run's file names: this executes it."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE.mp4")] = None
    """The file; of a training run also .gif. Default: impact.mp4, drop.mp4 or policy.mp4 in the
    folder of the run."""
    overwrite: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Replace a film that is there already."""

    def run(self) -> int:
        """Runs the command."""
        from mjgranular.picture.video import Film

        command = self._command()
        default = {"impact": VIDEO, "train": POLICY_FILM}.get(command, FILM)
        target = self.out or self.run_folder / default
        if target.suffix != ".mp4" and not (command == "train" and target.suffix == ".gif"):
            raise InputError(f"a film is written as .mp4, not {target.suffix or target.name!r}")
        if command != "train" and (self.on or self.seed is not None):
            raise InputError(f"--on and --seed are for training runs; {self.run_folder} is none")
        film = Film(
            camera=self.camera or ("side" if command == "impact" else "free"),
            seconds=self.seconds,
            width=self.width,
            height=self.height,
            fps=self.fps,
        )
        draws = {"impact": self._impact, "drop": self._model, "train": self._policy}
        if command not in draws:
            raise InputError(
                f"{self.run_folder} holds the result of '{command}': a video can be made of an "
                "impact, of a drop or of a training run"
            )
        draw = draws[command](film)
        folder = ResultFolder(target.parent, (target.name,))
        with folder.claimed(overwrite=self.overwrite):
            draw(folder, target.name)
        out.print(f"written to {target}", highlight=False, markup=False)
        return 0

    def _command(self) -> str:
        """What the folder is the result of; a name of a policy that comes with the package goes."""
        from mjgranular.learn.policies import shipped_policies

        if self.run_folder.exists() or self.run_folder.as_posix() not in shipped_policies():
            from mjgranular.cli.agents import is_environment

            what = self.run_folder.as_posix()
            if is_environment(what):
                raise InputError(
                    f"{what} is an environment: a film is made of a run, which mjgranular train "
                    f"{what} makes, or of a policy that `mjgranular list policies` lists"
                )
            return saved_command(self.run_folder)
        if self.out is None:
            raise InputError(
                f"a film of {self.run_folder} needs a file to write to: add --out FILE"
            )
        return "train"

    def _impact(self, film: Film) -> Draw:
        """How to film a drop of the link."""
        impact, summary, trajectory = read_impact(self.run_folder)
        film.check(impact.link)
        prints = read_prints(self.run_folder)
        return lambda folder, name: film_impact(
            folder, name, impact, trajectory, summary, film, prints
        )

    def _model(self, film: Film) -> Draw:
        """How to film a run of a user's model."""
        from mjgranular.picture.video import Motion, frames_of_model

        drop, arrays = read_drop(self.run_folder)
        if isinstance(drop.model, Chain) and drop.model.count > arrays["qpos"].shape[1]:
            raise OutputError(f"{self.run_folder} is damaged: its samples are of a shorter chain")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", GranularWarning)  # which the run has given
            model, _ = load(drop)
        if arrays["qpos"].shape[1] != model.nq:
            raise OutputError(
                f"{self.run_folder} has samples of {arrays['qpos'].shape[1]} positions, "
                f"{drop.title} has {model.nq}: it is not the model that ran"
            )
        motion = Motion(**{key: arrays[key] for key in ("t", "qpos", "point", "force")})
        count, pictures = frames_of_model(
            film, model, motion, surface_drawn(drop), prints_of(arrays), memory_of(drop, model)
        )
        return lambda folder, name: write_film(folder, name, film, lambda: (count, pictures))

    def _policy(self, film: Film) -> Draw:
        """How to film a policy."""
        from mjgranular.cli.agents import doubt_of, find_actor
        from mjgranular.learn.evaluate import FIRST_SEED, parse_variant
        from mjgranular.learn.film import film_episode
        from mjgranular.learn.sands import sands_made

        actor = find_actor(str(self.run_folder), trust=self.trust)
        arguments = {**actor.arguments, **parse_variant(self.on)}
        doubt = doubt_of(actor, self.on, sands_made(actor.environment, arguments))
        if doubt is not None:
            warn_user(doubt)

        def draw(folder: ResultFolder, name: str) -> None:
            with progress_bar("filming", film.seconds * film.fps, remaining=True) as show:
                folder.write(
                    name,
                    lambda path: film_episode(
                        path,
                        actor.environment,
                        arguments,
                        actor.make,
                        film,
                        seed=FIRST_SEED if self.seed is None else self.seed,
                        camera=self.camera,
                        progress=show,
                    ),
                )

        return draw
