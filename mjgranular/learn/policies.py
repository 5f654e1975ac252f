"""Policies: of a run, of one of its checkpoints, or of those that come with the package."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import mjgranular.models
from mjgranular._util import files
from mjgranular.errors import InputError, OutputError, UnknownNameError, warn_user
from mjgranular.experiment.folder import CONFIG
from mjgranular.learn.checkpoint import check_belongs
from mjgranular.learn.run import CHECKPOINTS, CURVE, POLICY, Run, open_run, read_curve
from mjgranular.learn.weights import (
    NORMALIZER,
    Normalizer,
    build_policy,
    read_normalizer,
    read_weights,
)

SHIPPED = Path(mjgranular.models.__file__).resolve().parent / "policies"
"""Folder of the policies that come with the package, each with the files of `POLICY_FILES`."""
POLICY_FILES = (CONFIG, POLICY, NORMALIZER, CURVE)
_LAST = 0.8
_TRIES = 3


@dataclass(frozen=True)
class Policy:
    """A trained policy.

    Attributes:
        run: the run that trained it.
        folder: folder with its files.
        model: a policy of Stable-Baselines3, `BasePolicy`.
        normalizer: scales its observations; None if they are not scaled.
    """

    run: Run
    folder: Path
    model: Any
    normalizer: Normalizer | None

    def act(self, observations: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """Return the actions, without noise.

        Args:
            observations: shape (n, ...).
            steps: number of steps since the episodes began, shape (n,); not used.
        """
        if self.normalizer is not None:
            observations = self.normalizer(observations)
        return self.model.predict(observations, deterministic=True)[0]

    def checked(self, env_id: str, env: Any) -> Policy:
        """Return the policy; raise if an environment has other observations or actions.

        Args:
            env_id: Gymnasium id of the environment.
            env: a `gymnasium.vector.VectorEnv`, or a `gymnasium.Env`.

        Raises:
            InputError: they differ; says how.
        """
        for what in ("observation", "action"):
            mine = getattr(self.model, f"{what}_space")
            there = getattr(env, f"single_{what}_space", None) or getattr(env, f"{what}_space")
            if mine.shape != there.shape or type(mine) is not type(there):
                raise InputError(
                    f"the policy {self.folder} is for {self.run.environment}: its {what}s are "
                    f"{_describe(mine)}, those of {env_id} {_describe(there)}"
                )
        return self


def load_policy(where: Path | str) -> Policy:
    """Load a policy as data: nothing in its files is executed.

    Args:
        where: a run's folder (its newest checkpoint is taken), a checkpoint's, a policy's folder or
            its `policy.zip`; or the name of a policy that comes with the package.

    Raises:
        OutputError: it has no policy, or the installed packages cannot read it.
        UnknownNameError: neither a folder nor a name; lists the names.
    """
    folder = _folder(where)
    tries = _TRIES
    while True:
        run = open_run(folder)
        newest = run.newest_checkpoint() if (folder / CHECKPOINTS).is_dir() else None
        holder = newest or folder
        tries -= 1
        try:
            policy = files.read_consistent(holder, POLICY, lambda run=run, at=holder: _load(run, at))
        except OutputError:
            # A running training may have removed the checkpoint for a newer one.
            if not tries or newest is None or newest.exists():
                raise
        else:
            _warn_of_version(run)
            return replace(policy, folder=folder)


def _load(run: Run, holder: Path) -> Policy:
    """Return the policy in the folder of a run or of one of its checkpoints."""
    file = files.latest_path(holder, POLICY)
    if not file.exists():
        raise OutputError(
            f"{run.path} has no policy yet: its training has written no checkpoint; go on with "
            f"mjgranular train --resume {run.path}"
        )
    if holder != run.path:
        check_belongs(holder, run)
    try:
        weights = read_weights(file)
        model = build_policy(run.settings, weights, file)
        normalizer = read_normalizer(
            files.latest_path(holder, NORMALIZER),
            normalized=run.settings.normalize_observations,
            shape=model.observation_space.shape,
        )
    except OutputError as error:
        raise OutputError(
            f"{error} (it was written with stable-baselines3 "
            f"{run.versions.get('stable-baselines3')}, torch {run.versions.get('torch')})"
        ) from None
    return Policy(run, holder, model, normalizer)


def shipped_policies() -> dict[str, Run]:
    """Return the policies that come with the package, by name."""
    found = sorted(SHIPPED.rglob(POLICY)) if SHIPPED.is_dir() else []
    folders = [file.parent for file in found]
    return {folder.relative_to(SHIPPED).as_posix(): open_run(folder) for folder in folders}


def last_return(run: Run) -> float | None:
    """Return the mean return over the last fifth of a run's learning curve; None without one.

    The last row alone would not do: after a checkpoint it has only the few episodes that ended
    early.
    """
    try:
        rows = read_curve(run.path / CURVE)
    except OutputError:
        return None
    if sum(row[2] for row in rows) <= 0:
        return None
    last = [row for row in rows if row[0] >= _LAST * rows[-1][0] and row[2] > 0]
    if not last:
        return None
    return float(np.average([row[3] for row in last], weights=[row[2] for row in last]))


def _folder(where: Path | str) -> Path:
    path = Path(where)
    if path.name == POLICY and path.is_file():
        return path.parent
    if path.is_dir():
        return path
    names = list(shipped_policies())
    if str(where) in names:
        return SHIPPED / str(where)
    raise UnknownNameError("run folder or policy", str(where), names)


def _warn_of_version(run: Run) -> None:
    """Warn if physics may have changed since the training."""
    there = str(run.versions.get("mujoco"))
    if there.partition(".")[0] != mujoco.__version__.partition(".")[0]:
        warn_user(f"{run.path} was trained with MuJoCo {there}, this is {mujoco.__version__}")


def _describe(space: Any) -> str:
    size = "x".join(map(str, space.shape)) or "1"
    return f"{size} number{'s' if size != '1' else ''} ({type(space).__name__})"
