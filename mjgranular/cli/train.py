"""`mjgranular train`: a policy for an environment."""

from __future__ import annotations

import importlib
import time
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from mjgranular._util.result_folder import ResultFolder
from mjgranular.cli.console import (
    err,
    out,
    print_json,
    progress_bar,
    show_error,
    show_warp_compilation,
)
from mjgranular.errors import InputError, MissingExtraError, warn_user
from mjgranular.learn import environments
from mjgranular.learn.run import Run, begin_run, open_run
from mjgranular.learn.sands import sands_of
from mjgranular.learn.settings import Settings, change, find_settings
from mjgranular.learn.train import Training, train

_REFRESH = 0.2  # [s]
_FIGURE = "curve.png"


@dataclass(frozen=True)
class TrainCommand:
    """Trains a policy with PPO, SAC or TD3 of Stable-Baselines3.

    ENV is an id of Gymnasium's: one of `mjgranular list envs` or any other, `my_module:My-v0`
    for your own. Each has its settings in a file; --set changes them one by one. Ctrl-C or SIGTERM
    ends the training with a checkpoint; --resume DIR goes on, also after a crash.
    """

    environment: Annotated[
        str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[ENV]", name="env")
    ] = None
    """Id of the environment."""
    resume: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Go on with the run in this folder, up to its --total-steps or to a new number of them."""
    trust: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """With --resume: import the module of an environment that only the run's file names: this
    executes it."""
    algorithm: Annotated[str | None, tyro.conf.arg(metavar="ppo|sac|td3")] = None
    """Default: the one that the settings name."""
    total_steps: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Steps of all environments together. Default: as in the settings."""
    settings: Annotated[Path | None, tyro.conf.arg(metavar="FILE.toml")] = None
    """Settings to read in place of the environment's own."""
    set: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE ...")] = ()
    """Changes of the settings: num_envs=8 net=[256,256] gamma=0.98 environment.medium=poppy_seed"""
    engine: Literal["local", "warp"] = "local"
    """Step environments on the cores of this machine, or all at once in MuJoCo Warp. A run may
    change with every --resume."""
    device: Annotated[str | None, tyro.conf.arg(metavar="cuda:0|cpu")] = None
    """With --engine warp: where. Default: a GPU where there is one."""
    num_envs: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Environments that are stepped at once, as --set num_envs=N."""
    processes: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Step each environment in a separate process, for custom ones, which are not a batch."""
    seed: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Of all random numbers. Default: 0."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder for the run. Default: runs/NAME-ALGORITHM-SEED."""
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print one JSON object at the end."""

    @property
    def _warp(self) -> str | None:
        return (self.device or "auto") if self.engine == "warp" else None

    def run(self) -> int:
        """Runs the command."""
        if self.device is not None and self.engine != "warp":
            raise InputError("--device is for --engine warp")
        run = self._begun() if self.resume is None else self._resumed(self.resume)
        with run.locked():
            if self.resume is not None:
                run = open_run(run.path, trust=self.trust)  # as it is now that it is ours
                if self.total_steps is not None:
                    run = run.extended(self.total_steps)
            try:
                training = self._train(run)
            except (InputError, MissingExtraError):
                if self.resume is None:
                    run.discard()
                raise
            if training.progress.curve:
                _draw(run, training)
        return self._tell(run, training)

    def _asked(self) -> tuple[str, Settings, int]:
        """Environment, settings and seed, as far as they are right."""
        if self.environment is None:
            raise InputError(
                "train needs an environment, for example mjgranular train mjgranular/ChainSwim-v0, "
                "or --resume DIR"
            )
        if self.trust:
            raise InputError("--trust is for --resume")
        environments.find_spec(self.environment)
        settings = change(self._settings(self.environment), self._changes)
        if self.total_steps is not None:
            settings = replace(settings, total_steps=self.total_steps)
        if "render_mode" in settings.environment:
            raise InputError(
                "nothing is drawn while a policy is trained: leave environment.render_mode away; "
                "mjgranular render films the run"
            )
        if self.processes:
            settings = replace(settings, processes=True)
        seed = 0 if self.seed is None else self.seed
        # A mistake in the arguments of the environment is found before a folder is made.
        self._look(environments.one(self.environment, settings.environment))
        return self.environment, settings, seed

    def _look(self, env: Any) -> None:
        """Says so where a policy is trained without sand."""
        with closing(env):
            sands = sands_of(env)
        if sands == []:
            name = _short(str(self.environment)).rpartition("-v")[0]
            there = importlib.import_module("mjgranular.envs.tasks").tasks
            ours = f"mjgranular/{name}-v0" if name in there else "what `mjgranular list envs` lists"
            warn_user(f"{self.environment} has no sand in its model: {ours} has")

    def _begun(self) -> Run:
        environment, settings, seed = self._asked()
        path = self.out or Path("runs") / f"{_short(environment)}-{settings.algorithm}-{seed}"
        return begin_run(path, environment, settings, seed=seed)

    def _settings(self, environment: str) -> Settings:
        algorithm = None if self.algorithm is None else self.algorithm.lower()
        return find_settings(environment, algorithm=algorithm, file=self.settings)

    def _resumed(self, path: Path) -> Run:
        self._check_nothing_repeated(path)
        run = open_run(path, trust=self.trust)
        run.check_environment()
        return run

    @property
    def _changes(self) -> tuple[str, ...]:
        return self.set if self.num_envs is None else (*self.set, f"num_envs={self.num_envs}")

    def _check_nothing_repeated(self, path: Path) -> None:
        """Raise if an option repeats a setting of the resumed run."""
        given = {
            "ENV": self.environment,
            "--algorithm": self.algorithm,
            "--settings": self.settings,
            "--set": self.set or None,
            "--num-envs": self.num_envs,
            "--processes": self.processes or None,
            "--seed": self.seed,
            "--out": self.out,
        }
        extra = [name for name, value in given.items() if value is not None]
        if extra:
            raise InputError(
                f"--resume uses the settings of {path}: remove {', '.join(extra)} "
                "(--total-steps may be given)"
            )

    def _train(self, run: Run) -> Training:
        total = run.settings.total_steps
        if self._warp is not None:
            show_warp_compilation()
        with progress_bar(run.name, total, remaining=True) as show:
            shown = 0.0

            def report(steps: int, newest: float | None) -> None:
                nonlocal shown
                if time.monotonic() - shown > _REFRESH:
                    shown = time.monotonic()
                    reached = "" if newest is None else f", return {newest:.4g}"
                    show(steps, f"{run.name}: {steps:,} of {total:,} steps{reached}")

            return train(run, report=report, warp=self._warp)

    def _tell(self, run: Run, training: Training) -> int:
        progress = training.progress
        newest = progress.curve[-1][3] if progress.curve else None
        if self.json:
            print_json(
                {
                    **run.config(),
                    "run": str(run.path),
                    "steps": progress.steps,
                    "seconds": progress.seconds,
                    "finished": training.stopped_by is None,
                    "mean_return": newest,
                }
            )
        else:
            reached = "no episode ended" if newest is None else f"last mean return {newest:.4g}"
            out.print(
                f"{run.name}: {progress.steps} steps in {progress.seconds:.0f} s, {reached}",
                highlight=False,
                markup=False,
            )
            out.print(f"in {run.path}", highlight=False, markup=False)
        if training.stopped_by is not None:
            show_error(
                f"stopped after {progress.steps} steps, all of them kept; resume with mjgranular "
                f"train --resume {run.path}"
            )
            return 128 + training.stopped_by
        if progress.steps == training.began:
            err.print(
                f"nothing to do: the run has its {progress.steps} steps; a greater --total-steps "
                "goes on",
                highlight=False,
                markup=False,
            )
        return 0


def _short(environment: str) -> str:
    """The name of an environment, for a folder."""
    return environment.replace(":", "/").rpartition("/")[2]


def _draw(run: Run, training: Training) -> None:
    """Draws the learning curve, where matplotlib is installed: the numbers are there anyway."""
    from mjgranular.learn.figures import draw_curve

    with suppress(MissingExtraError):
        folder = ResultFolder(run.path, (_FIGURE,))
        curve = training.progress.curve
        folder.write(_FIGURE, lambda path: draw_curve(path, curve, run.name))
