"""Checkpoints: all that a training needs to go on, and the policy as it is evaluated."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mjgranular.errors import OutputError
from mjgranular.experiment.folder import CONFIG
from mjgranular.learn import durable
from mjgranular.learn.normalizer import FILE as NORMALIZER
from mjgranular.learn.normalizer import normalizer_state, restore_normalizer
from mjgranular.learn.run import CURVE, POLICY, REPLAY, STATE, Run, curve_text, read_curve
from mjgranular.learn.run import read_state as read_state
from mjgranular.learn.settings import algorithm_class

# Of the episodes under way, which a checkpoint does not keep: see `train.begin_episodes`.
_OF_EPISODES = (
    "_last_obs",
    "_last_original_obs",
    "_last_episode_starts",
    "ep_info_buffer",
    "ep_success_buffer",
)


@dataclass(frozen=True)
class Progress:
    """How far a training has come.

    Attributes:
        steps: of all environments together.
        seconds: spent in training, all sittings together [s].
        curve: rows of `run.CURVE_COLUMNS`.
    """

    steps: int
    seconds: float
    curve: Sequence[tuple[float, ...]]


def save_checkpoint(run: Run, model: Any, progress: Progress) -> Path:
    """Writes a checkpoint whole or not at all, and removes all but the newest two.

    Args:
        run: whose folder it goes to.
        model: an algorithm of Stable-Baselines3 on a `VecNormalize`.
        progress: how far it has come.

    Returns:
        The checkpoint's folder.

    Raises:
        OutputError: it cannot be written.
    """

    def fill(folder: Path) -> None:
        _write_json(folder / CONFIG, run.config())
        model.save(folder / POLICY, exclude=_OF_EPISODES)
        _write_json(folder / NORMALIZER, normalizer_state(model.get_vec_normalize_env()))
        (folder / CURVE).write_text(curve_text(progress.curve), encoding="utf-8")
        if hasattr(model, "replay_buffer"):
            model.save_replay_buffer(folder / REPLAY)
        _write_json(folder / STATE, {"steps": progress.steps, "seconds": progress.seconds})

    folder = run.checkpoint_folder(progress.steps)
    durable.write_folder(folder, fill)
    run.remove_old_checkpoints()
    return folder


def load_checkpoint(folder: Path, run: Run, env: Any) -> tuple[Any, Progress]:
    """The model and progress of a checkpoint.

    Args:
        folder: of the checkpoint, without a fault.
        run: that it belongs to.
        env: a fresh `VecNormalize`, which gets the saved state.

    Raises:
        OutputError: the installed packages cannot read it; says which versions wrote it.
    """
    restore_normalizer(env, json.loads((folder / NORMALIZER).read_text(encoding="utf-8")))
    try:
        model = algorithm_class(run.settings.algorithm).load(folder / POLICY, env, device="cpu")
        if hasattr(model, "replay_buffer"):
            model.load_replay_buffer(folder / REPLAY)
    except Exception as error:  # unpickling what other versions wrote fails in many ways
        raise OutputError(
            f"{folder} cannot be read by the packages installed here ({type(error).__name__}: "
            f"{error}); it was written with {_versions(run)}"
        ) from None
    state = read_state(folder)
    return model, Progress(state["steps"], state["seconds"], read_curve(folder / CURVE))


def write_policy(run: Run, checkpoint: Path) -> None:
    """Puts what evaluation needs from a checkpoint into the run's folder itself."""
    for name in (POLICY, NORMALIZER):
        durable.write_bytes(run.path / name, (checkpoint / name).read_bytes())


def _versions(run: Run) -> str:
    names = ("stable-baselines3", "torch", "gymnasium", "numpy")
    return ", ".join(f"{name} {run.versions.get(name)}" for name in names)


def _write_json(file: Path, content: Any) -> None:
    file.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
