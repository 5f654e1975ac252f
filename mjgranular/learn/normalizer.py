"""Running mean and variance of observations and returns, saved as numbers that anyone can read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mjgranular.errors import OutputError
from mjgranular.saved import number, read_json

FILE = "normalizer.json"


@dataclass(frozen=True)
class Normalizer:
    """Observations by their mean and variance.

    Attributes:
        mean: shape of one observation.
        variance: the same.
        clip: greatest size of a normalised number.
        epsilon: added to the variance.
    """

    mean: np.ndarray
    variance: np.ndarray
    clip: float
    epsilon: float

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        """Normalised as `VecNormalize` does it."""
        scaled = (observations - self.mean) / np.sqrt(self.variance + self.epsilon)
        return np.clip(scaled, -self.clip, self.clip).astype(np.float32)


def read_normalizer(file: Path, *, normalized: bool, shape: tuple[int, ...]) -> Normalizer | None:
    """Reads what `normalizer_state` gave; None if observations are not normalised.

    Args:
        file: the file.
        normalized: whether the policy was trained on normalised observations.
        shape: of one observation.

    Raises:
        OutputError: it is missing, damaged, or that of another policy.
    """
    state = read_state(file, normalized=normalized, shape=shape)
    if not normalized:
        return None
    return Normalizer(state["mean"], state["variance"], state["clip"], state["epsilon"])


def read_state(file: Path, *, normalized: bool, shape: tuple[int, ...]) -> dict[str, Any]:
    """Reads and checks the state; the rest is as for `read_normalizer`."""
    content = read_json(file)
    if content.get("observations") is not normalized:
        raise OutputError(
            f"{file} is not of this policy: its observations are "
            f"{'' if normalized else 'not '}normalised"
        )
    state: dict[str, Any] = {}
    for name in ("clip", "epsilon", "count", "return_mean", "return_variance", "return_count"):
        state[name] = number(content, name, file)
        if state[name] is None or (name != "return_mean" and state[name] < 0):
            raise OutputError(f"{file} is damaged: {name} must be a number of at least 0")
    for name in ("mean", "variance"):
        state[name] = _vector(content.get(name), name, file, shape) if normalized else None
    if normalized and ((state["variance"] + state["epsilon"]) <= 0).any():
        raise OutputError(f"{file} is damaged: a variance must be positive")
    return state


def _vector(content: object, name: str, file: Path, shape: tuple[int, ...]) -> np.ndarray:
    try:
        vector = np.array(content, dtype=float)
    except (ValueError, TypeError, OverflowError):
        raise OutputError(f"{file} is damaged: {name} must be numbers") from None
    if vector.shape != shape:
        raise OutputError(
            f"{file} is not of this policy: its {name} has shape {vector.shape}, an observation "
            f"{shape}"
        )
    if not np.isfinite(vector).all():
        raise OutputError(f"{file} is damaged: {name} must be finite numbers")
    return vector


def normalizer_state(env: Any) -> dict[str, Any]:
    """The state of a `VecNormalize`; Python writes floats so that they read back the same."""
    observations, returns = env.obs_rms if env.norm_obs else None, env.ret_rms
    return {
        "observations": env.norm_obs,
        "mean": observations.mean.tolist() if observations else [],
        "variance": observations.var.tolist() if observations else [],
        "count": float(observations.count) if observations else 0.0,
        "clip": float(env.clip_obs),
        "epsilon": float(env.epsilon),
        "return_mean": float(returns.mean),
        "return_variance": float(returns.var),
        "return_count": float(returns.count),
    }


def restore_normalizer(env: Any, state: Mapping[str, Any]) -> None:
    """Puts the state that `read_state` gave into a `VecNormalize`."""
    if env.norm_obs:
        env.obs_rms.mean = state["mean"]
        env.obs_rms.var = state["variance"]
        env.obs_rms.count = state["count"]
    env.ret_rms.mean = np.float64(state["return_mean"])
    env.ret_rms.var = np.float64(state["return_variance"])
    env.ret_rms.count = state["return_count"]
