"""`mjgranular train`: a policy for an environment."""

import importlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro

from mjgranular._util.checks import require
from mjgranular.cli.console import note, out, print_json, progress_bar, show_error
from mjgranular.cli.options import Flag, given_options, option
from mjgranular.errors import InputError, MissingExtraError, warn_user
from mjgranular.learn import environments
from mjgranular.learn.run import Run, begin_run, mean_returns, open_run
from mjgranular.learn.settings import change, find_settings
from mjgranular.learn.train import Training, train


@dataclass(frozen=True)
class TrainCommand:
    """Train a policy with PPO, SAC or TD3 of Stable-Baselines3.

    ENV is a Gymnasium id: one of `mjgranular list envs` or any other, `my_module:My-v0` for a
    custom one. Each has its settings in a file; --set changes them one by one. Ctrl-C or SIGTERM
    ends the training with a checkpoint; --resume DIR continues it, also after a crash.
    """

    environment: Annotated[
        str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[ENV]", name="env")
    ] = None
    """Id of the environment."""
    resume: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Resume the run in this folder, up to its --total-steps or to a new number of them."""
    trust: Flag = False
    """With --resume: import and so execute the module of an environment that only the run's file
    names."""
    algorithm: Annotated[str | None, tyro.conf.arg(metavar="ppo|sac|td3")] = None
    """Default: the one that the settings name."""
    total_steps: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Steps of all environments together. Default: as in the settings."""
    settings: Annotated[Path | None, tyro.conf.arg(metavar="FILE.toml|ID")] = None
    """Settings to take in place of those of the environment: a file, or another environment's."""
    set: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE ...")] = ()
    """Changes of the settings: num_envs=8 net=[256,256] gamma=0.98 environment.medium=poppy_seed"""
    engine: Literal["local", "warp"] = "local"
    """Step environments on the cores of this machine, or all at once in MuJoCo Warp. A run may
    change with every --resume."""
    device: Annotated[str | None, tyro.conf.arg(metavar="cuda:0|cpu")] = None
    """With --engine warp: where. Default: a GPU if there is one."""
    seed: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Seed of all random numbers. Default: 0."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder for the run. Default: runs/NAME-ALGORITHM-SEED."""
    json: Flag = False
    """Print one JSON object at the end."""

    def run(self) -> int:
        if self.device is not None and self.engine != "warp":
            raise InputError("--device is for --engine warp")
        run = self._new_run() if self.resume is None else self._saved_run(self.resume)
        with run.locked():
            if self.resume is not None:
                run = open_run(run.path, trust=self.trust)  # it may have changed before the lock
                if self.total_steps is not None:
                    run = run.extended(self.total_steps)
            try:
                training = self._train(run)
            except (InputError, MissingExtraError):
                if self.resume is None:
                    run.discard()
                raise
        return self._show(run, training)

    def _new_run(self) -> Run:
        if self.environment is None:
            raise InputError(
                "train needs an environment, for example mjgranular train mjgranular/ChainSwim-v0, "
                "or --resume DIR"
            )
        if self.trust:
            raise InputError("--trust is for --resume")
        environments.find_spec(self.environment)
        algorithm = None if self.algorithm is None else self.algorithm.lower()
        settings = find_settings(self.environment, algorithm=algorithm, file=self.settings)
        settings = change(settings, self.set)
        if self.total_steps is not None:
            settings = replace(settings, total_steps=self.total_steps)
        name, seed = self.environment.replace(":", "/").rpartition("/")[2], self.seed or 0
        path = self.out or Path("runs") / f"{name}-{settings.algorithm}-{seed}"
        run = begin_run(path, self.environment, settings, seed=seed)
        if run.sand == []:
            task = name.rpartition("-v")[0]
            known = task in importlib.import_module("mjgranular.envs").tasks
            other = f"mjgranular/{task}-v0" if known else "what `mjgranular list envs` lists"
            warn_user(f"{self.environment} has no sand in its model: {other} has")
        return run

    def _saved_run(self, path: Path) -> Run:
        names = ("algorithm", "settings", "set", "seed", "out")
        given = ["ENV"] if self.environment is not None else []
        given += [option(name) for name in given_options(self, *names)]
        if given:
            raise InputError(
                f"--resume uses the settings of {path}: remove {', '.join(given)} "
                "(--total-steps may be given)"
            )
        run = open_run(path, trust=self.trust)
        run.check_environment()
        return run

    def _train(self, run: Run) -> Training:
        total, warp = run.settings.total_steps, None
        if self.engine == "warp":
            warp = self.device or "auto"
            wp = require("warp", extra="warp", purpose="Training in MuJoCo Warp")
            wp.config.log_level = wp.LOG_ERROR  # it prints a line for each of its modules
            note("MuJoCo Warp compiles its kernels: once per machine, some minutes")
        with progress_bar(run.name, total, remaining=True) as show:

            def report(steps: int, newest: float | None) -> None:
                reached = "" if newest is None else f", return {newest:.4g}"
                show(steps, f"{run.name}: {steps:,} of {total:,} steps{reached}")

            return train(run, report=report, warp=warp)

    def _show(self, run: Run, training: Training) -> int:
        progress, stopped_by = training.progress, training.stopped_by
        means = mean_returns(progress.curve, run.settings.num_envs)
        newest = means[-1][1] if means else None
        if self.json:
            print_json(
                {
                    **run.config(),
                    "run": str(run.path),
                    "steps": progress.steps,
                    "seconds": progress.seconds,
                    "finished": stopped_by is None,
                    "mean_return": newest,
                }
            )
        else:
            reached = "no episode ended" if newest is None else f"last mean return {newest:.4g}"
            out.print(f"{run.name}: {progress.steps} steps in {progress.seconds:.0f} s, {reached}")
            out.print(f"in {run.path}")
        if stopped_by is not None:
            show_error(
                f"stopped after {progress.steps} steps, all of them saved; resume with mjgranular "
                f"train --resume {run.path}"
            )
            return 128 + stopped_by
        if progress.steps == training.began:
            note(f"nothing to do: the run has {progress.steps} steps; use a greater --total-steps")
        return 0
