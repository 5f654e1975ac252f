"""Files of a policy, read as data: weights and statistics of observations, nothing unpickled.

A file of Stable-Baselines3 is a zip with tensors, which PyTorch can read without executing
anything, and an entry `data`, half of which are pickles. Their content follows from the settings of
the run, except the spaces, which we add to the file as JSON.
"""

from __future__ import annotations

import io
import itertools
import json
import math
import pickle
import warnings
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mjgranular._util.extras import require
from mjgranular._util.io import number, parse_json, read_json
from mjgranular.errors import OutputError
from mjgranular.learn.settings import Settings

SPACES = "spaces.json"
NORMALIZER = "normalizer.json"
_DATA = "data"
_TENSORS = ".pth"
_VARIABLES = "pytorch_variables"
_COUNTERS = ("num_timesteps", "_n_updates", "_episode_num")
_PURPOSE = "Reading a policy"
_SMALL = 64 * 2**20  # bytes; an entry may unpack to this much, or to
_RATIO = 8  # this many times its size in the file; both chosen
_BOUNDS = ("low", "high")
_TYPES = ("float32", "float64", "float16", "int8", "int16", "int32", "int64", "uint8", "uint16")


@dataclass(frozen=True)
class Weights:
    """Content of a file of Stable-Baselines3.

    Attributes:
        observation_space: Gymnasium space of the observations.
        action_space: Gymnasium space of the actions.
        parameters: state dictionaries: "policy", "policy.optimizer", ...
        variables: further tensors, by name.
        counters: integers of the algorithm, by name.
    """

    observation_space: Any
    action_space: Any
    parameters: Mapping[str, Any]
    variables: Mapping[str, Any]
    counters: Mapping[str, int]


def read_weights(file: Path) -> Weights:
    """Read a file that `Algorithm.save` and `add_spaces` wrote; execute nothing in it.

    Raises:
        OutputError: it cannot be read, or is not such a file; says what is wrong.
    """
    if not file.is_file():
        raise OutputError(f"{file} cannot be read: there is no such file")
    try:
        with zipfile.ZipFile(file) as archive:
            data, described = (
                parse_json(_entry(archive, name, file).decode(), f"{name} in {file}")
                for name in (_DATA, SPACES)
            )
            tensors = {
                name.removesuffix(_TENSORS): _tensors(_entry(archive, name, file))
                for name in archive.namelist()
                if name.endswith(_TENSORS)
            }
    except OutputError:
        raise
    except Exception as error:  # zip, zlib and torch fail in many ways
        raise OutputError(f"{file} is damaged: {brief(error)}") from None
    variables = tensors.pop(_VARIABLES, None)
    counters = {name: data[name] for name in _COUNTERS if name in data}
    for name, value in counters.items():
        if not isinstance(value, int) or not 0 <= value < 2**53:
            raise OutputError(f"{file} is damaged: {name} must be a whole number")
    most = sum(tensor.numel() for tensor in _state(tensors.get("policy"), file).values())
    spaces = {}
    for name in ("observation_space", "action_space"):
        try:
            spaces[name] = _space(described[name], most)
        except Exception as error:  # there may be anything in place of a space
            raise OutputError(f"{file} is damaged: {name}: {brief(error)}") from None
    variables = variables if isinstance(variables, dict) else {}
    return Weights(**spaces, parameters=tensors, variables=variables, counters=counters)


def add_spaces(file: Path, observation_space: Any, action_space: Any) -> None:
    """Add the spaces to a file of Stable-Baselines3, which ignores them, as plain numbers."""
    spaces = {"observation_space": observation_space, "action_space": action_space}
    with zipfile.ZipFile(file, "a") as archive:
        described = {name: _as_json(space) for name, space in spaces.items()}
        archive.writestr(SPACES, json.dumps(described))


def policy_arguments(settings: Settings) -> dict[str, Any]:
    """Return the arguments of a policy's class in Stable-Baselines3."""
    nn = require("torch", extra="train", purpose="Training a policy").nn
    activation = {"tanh": nn.Tanh, "relu": nn.ReLU, "elu": nn.ELU}[settings.activation]
    return {"net_arch": list(settings.net), "activation_fn": activation, **settings.policy}


def build_policy(settings: Settings, weights: Weights, file: Path) -> Any:
    """Build the policy that the settings describe, with these weights: a `BasePolicy`.

    Args:
        settings: settings of the run.
        weights: read from a file.
        file: named in the message.

    Raises:
        OutputError: weights and settings do not match.
    """
    check_size(settings, weights, file)
    sb3 = require("stable_baselines3", extra="train", purpose=_PURPOSE)
    try:
        arguments = policy_arguments(settings)
        if settings.algorithm != "td3":
            arguments["use_sde"] = bool(settings.arguments.get("use_sde", False))
        policy = getattr(sb3, settings.algorithm).MlpPolicy(
            weights.observation_space, weights.action_space, lambda _: 0.0, **arguments
        )
        policy.load_state_dict(weights.parameters["policy"])
    except Exception as error:  # settings may be anything
        raise OutputError(
            f"{file} is not the policy of its settings: {brief(error)}; it was written by another "
            "run, or is damaged"
        ) from None
    policy.set_training_mode(False)
    return policy


def check_size(settings: Settings, weights: Weights, file: Path) -> None:
    """Raise if settings describe a net larger than the weights, before it is made.

    Raises:
        OutputError: it is.
    """
    state = weights.parameters["policy"]
    most = sum(tensor.numel() for tensor in state.values())
    for widths in (list(settings.net), *_lists(settings.policy)):
        between = sum(a * b for a, b in itertools.pairwise(widths))
        if len(widths) > len(state) or between > most or sum(widths) > most:
            raise OutputError(
                f"{file} is not the policy of its settings: they ask for a net of {widths[:8]}"
            )
    critics = settings.policy.get("n_critics", 1)
    if not isinstance(critics, int) or critics > len(state):
        raise OutputError(f"{file} is not the policy of its settings: n_critics is {critics!r}")


def _entry(archive: zipfile.ZipFile, name: str, file: Path) -> bytes:
    entry = archive.getinfo(name)
    if entry.file_size > max(_SMALL, _RATIO * entry.compress_size):
        raise OutputError(f"{file} is damaged: {name} is larger than anything that belongs there")
    return archive.read(name)


def _tensors(content: bytes) -> Any:
    """Read a file of PyTorch, if it has only tensors and plain values."""
    torch = require("torch", extra="train", purpose=_PURPOSE)
    # Its older kinds of files are not zips, and were not safe to read in older versions.
    if not content.startswith(b"PK"):
        raise pickle.UnpicklingError
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about the content of an untrusted file
        return torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)


def _state(state: object, file: Path) -> dict[str, Any]:
    """Return a policy's weights after checking that they are finite numbers by name."""
    torch = require("torch", extra="train", purpose=_PURPOSE)
    if not isinstance(state, dict) or not state:
        raise OutputError(f"{file} is damaged: it holds no weights of a policy")
    for name, value in state.items():
        # One that is not contiguous may be far larger than the file.
        plain = isinstance(value, torch.Tensor) and value.layout == torch.strided
        if not plain or not value.is_contiguous() or not value.is_floating_point():
            raise OutputError(f"{file} is damaged: {str(name)[:50]!r} is no array of numbers")
        if not bool(torch.isfinite(value).all()):
            raise OutputError(f"{file} is damaged: {str(name)[:50]!r} must be finite numbers")
    return state


def _lists(value: object) -> list[list[int]]:
    """Return the lists of integers within a value."""
    if isinstance(value, Mapping):
        return [found for item in value.values() for found in _lists(item)]
    if isinstance(value, (list, tuple)):
        mine = [item for item in value if isinstance(item, int)]
        return [mine, *(found for item in value for found in _lists(item))]
    return []


# Spaces: {"type": "Box", "shape": [3], "dtype": "float32", "low": [...], "high": [...]}


def _as_json(space: Any) -> dict[str, Any]:
    described: dict[str, Any] = {"type": type(space).__name__}
    if described["type"] == "Discrete":
        return described | {"n": int(space.n), "start": int(space.start)}
    described["shape"] = list(space.shape)
    if described["type"] == "Box":
        described["dtype"] = str(space.dtype)
        for name in _BOUNDS:  # as strings: JSON has no infinity
            described[name] = [repr(float(value)) for value in getattr(space, name).flat]
    elif described["type"] == "MultiDiscrete":
        described["nvec"] = [int(n) for n in space.nvec.flat]
    return described


def _space(described: Mapping[str, Any], most: int) -> Any:
    """Return a Gymnasium space; one of more than `most` numbers cannot be that of a policy."""
    spaces = require("gymnasium.spaces", extra="train", purpose=_PURPOSE)
    kind = described["type"]
    if kind == "Discrete":
        n, start = int(described["n"]), int(described["start"])
        if not 0 < n <= most or abs(start) > 2**31:
            raise ValueError(f"{n} actions")
        return spaces.Discrete(n, start=start)
    shape = tuple(int(length) for length in described["shape"])
    if any(length < 0 for length in shape) or not 0 < math.prod(shape) <= most:
        raise ValueError(f"a shape of {shape[:8]}")
    if kind == "Box":
        if described["dtype"] not in _TYPES:
            raise ValueError("its numbers are of no known type")
        low, high = (
            np.array([float(v) for v in described[name]]).reshape(shape).astype(described["dtype"])
            for name in _BOUNDS
        )
        if not (low <= high).all():
            raise ValueError("its bounds are the wrong way round")
        return spaces.Box(low, high, shape, np.dtype(described["dtype"]).type)
    if kind == "MultiDiscrete":
        nvec = np.array([int(n) for n in described["nvec"]]).reshape(shape)
        if not (nvec > 0).all() or nvec.sum() > most:
            raise ValueError(f"{nvec.sum()} actions")
        return spaces.MultiDiscrete(nvec)
    if kind == "MultiBinary":
        return spaces.MultiBinary(shape[0] if len(shape) == 1 else shape)
    raise ValueError(f"there is no space {str(kind)[:50]!r}")


def brief(error: Exception) -> str:
    """Return an error of a library in a few words."""
    if isinstance(error, pickle.UnpicklingError):
        return "it holds more than numbers, or what is none"
    text = "".join(c if c.isprintable() else " " for c in str(error))
    text = " ".join(text.split())[:200]
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


@dataclass(frozen=True)
class Normalizer:
    """Scales observations as `VecNormalize` of Stable-Baselines3 does.

    Attributes:
        mean: shape of one observation.
        variance: shape of one observation.
        clip: largest absolute value of a scaled number.
        epsilon: added to the variance.
    """

    mean: np.ndarray
    variance: np.ndarray
    clip: float
    epsilon: float

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        scaled = (observations - self.mean) / np.sqrt(self.variance + self.epsilon)
        return np.clip(scaled, -self.clip, self.clip).astype(np.float32)


def read_normalizer(file: Path, *, normalized: bool, shape: tuple[int, ...]) -> Normalizer | None:
    """Read the normalizer of a policy; None if its observations are not normalized.

    The arguments and errors are those of `read_statistics`.
    """
    state = read_statistics(file, normalized=normalized, shape=shape)
    if not normalized:
        return None
    return Normalizer(*(state[name] for name in ("mean", "variance", "clip", "epsilon")))


def read_statistics(file: Path, *, normalized: bool, shape: tuple[int, ...]) -> dict[str, Any]:
    """Read and check what `statistics_of` returned.

    Args:
        file: the file.
        normalized: whether the policy was trained on normalized observations.
        shape: shape of one observation.

    Raises:
        OutputError: it is missing, damaged, or from another policy.
    """
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
    if normalized:
        for name in ("mean", "variance"):
            state[name] = _vector(content.get(name), name, file, shape)
        if (state["variance"] + state["epsilon"] <= 0).any():
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


def statistics_of(env: Any) -> dict[str, Any]:
    """Return the statistics of a `VecNormalize`; floats in JSON read back the same."""
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


def restore_statistics(env: Any, state: Mapping[str, Any]) -> None:
    """Put what `read_statistics` returned into a `VecNormalize`."""
    if env.norm_obs:
        env.obs_rms.mean, env.obs_rms.var = state["mean"], state["variance"]
        env.obs_rms.count = state["count"]
    env.ret_rms.mean = np.float64(state["return_mean"])
    env.ret_rms.var = np.float64(state["return_variance"])
    env.ret_rms.count = state["return_count"]
