"""Running mean and variance of observations and returns, saved as numbers that anyone can read."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

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


def read_normalizer(file: Path) -> Normalizer | None:
    """Reads what `normalizer_state` gave; None if observations are not normalised."""
    if not file.exists():
        return None
    state = json.loads(file.read_text(encoding="utf-8"))
    if not state["observations"]:
        return None
    return Normalizer(
        np.array(state["mean"]), np.array(state["variance"]), state["clip"], state["epsilon"]
    )


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
    """Puts the state into a `VecNormalize`."""
    if env.norm_obs:
        env.obs_rms.mean = np.array(state["mean"])
        env.obs_rms.var = np.array(state["variance"])
        env.obs_rms.count = state["count"]
    env.ret_rms.mean = np.float64(state["return_mean"])
    env.ret_rms.var = np.float64(state["return_variance"])
    env.ret_rms.count = state["return_count"]
