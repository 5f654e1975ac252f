"""Policies: of a run, of one of its checkpoints, or of those that come with the package."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import mujoco
import numpy as np

import mjgranular.models
from mjgranular._util import files
from mjgranular._util.checks import check_name
from mjgranular._util.result_folder import CONFIG
from mjgranular.errors import OutputError, warn_user
from mjgranular.learn.checkpoint import Normalizer, build_policy, check_spaces, read_weights
from mjgranular.learn.run import CHECKPOINTS, CURVE, NORMALIZER, POLICY, Run, open_run

SHIPPED = Path(mjgranular.models.__file__).resolve().parent / "policies"
"""Folder of the policies that come with the package, each with the files of `POLICY_FILES`."""
POLICY_FILES = (CONFIG, POLICY, NORMALIZER, CURVE)


@dataclass(frozen=True)
class Policy:
    """A trained policy."""

    run: Run  # the run that trained it
    folder: Path  # folder with its files
    model: Any  # a policy of Stable-Baselines3, `BasePolicy`
    normalizer: Normalizer  # scales its observations

    def act(self, observations: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """Return the actions, without noise; `steps` are not used."""
        return self.model.predict(self.normalizer(observations), deterministic=True)[0]

    def checked(self, env_id: str, env: Any) -> Self:
        """Return the policy; raise `InputError` if an environment has other spaces."""
        check_spaces(self.model, env, self.folder, env_id)
        return self


def load_policy(where: Path | str) -> Policy:
    """Load a policy as data: nothing in its files is executed.

    Args:
        where: a run's folder (its newest checkpoint is taken), a checkpoint's, a policy's folder; a
            `policy.zip`; or the name of a policy that comes with the package.

    Raises:
        OutputError: it has no policy, or the installed packages cannot read it.
        UnknownNameError: neither a folder nor a name; lists the names.
    """
    folder = _folder(where)
    run = open_run(folder)
    whole = (folder / CHECKPOINTS).is_dir() and Path(where).name != POLICY
    newest = run.newest_checkpoint() if whole else None
    holder = newest or folder
    policy = files.read_consistent(holder, POLICY, lambda: _load(run, holder))
    trained_with = str(run.versions.get("mujoco"))
    if trained_with.partition(".")[0] != mujoco.__version__.partition(".")[0]:
        warn_user(f"{run.path} was trained with MuJoCo {trained_with}, not {mujoco.__version__}")
    return replace(policy, folder=folder)


def _load(run: Run, holder: Path) -> Policy:
    file = files.latest_path(holder, POLICY)
    if not file.exists():
        raise OutputError(
            f"{run.path} has no policy yet, as its training has written no checkpoint: resume it "
            f"with mjgranular train --resume {run.path}"
        )
    try:
        model = build_policy(run.settings, read_weights(file), file)
        statistics = files.latest_path(holder, NORMALIZER)
        normalizer = Normalizer.read(statistics, run.settings, model.observation_space.shape)
    except OutputError as error:
        raise OutputError(f"{error} (it was written with {run.version_names()})") from None
    return Policy(run, holder, model, normalizer)


def shipped_policies() -> dict[str, Run]:
    """Return the policies that come with the package, by name."""
    folders = sorted(file.parent for file in SHIPPED.rglob(POLICY))
    return {folder.relative_to(SHIPPED).as_posix(): open_run(folder) for folder in folders}


def _folder(where: Path | str) -> Path:
    path = Path(where)
    if path.name == POLICY and path.is_file():
        return path.parent
    if path.is_dir():
        return path
    check_name("run folder or policy", str(where), shipped_policies())
    return SHIPPED / str(where)
