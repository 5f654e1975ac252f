"""Policy files, read as data: weights and spaces, without unpickling.

A policy is a zip file of Stable-Baselines3. It holds tensors, which PyTorch reads without executing
anything, and an entry `data`, half of which are pickles. What these contain follows from the
settings of the run, except for the spaces, which are added to the file as JSON.
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
from mjgranular._util.io import parse_json
from mjgranular.errors import InputError, OutputError
from mjgranular.learn.settings import Settings

_SPACES = "spaces.json"
_TENSORS = ".pth"
_COUNTERS = ("num_timesteps", "_n_updates", "_episode_num")
_LARGEST_ENTRY = 64 * 2**20  # bytes; an entry of a zip file may unpack to this much, or to
_LARGEST_RATIO = 8  # this many times its size in the file; both chosen


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
    """Read a file of Stable-Baselines3 with spaces; execute nothing in it."""
    if not file.is_file():
        raise OutputError(f"{file} cannot be read: there is no such file")
    try:
        with zipfile.ZipFile(file) as archive:
            data, described = (
                parse_json(_entry(archive, name).decode(), name) for name in ("data", _SPACES)
            )
            tensors = {
                name.removesuffix(_TENSORS): _tensors(_entry(archive, name))
                for name in archive.namelist()
                if name.endswith(_TENSORS)
            }
        variables = tensors.pop("pytorch_variables", None) or {}
        counters = {name: data[name] for name in _COUNTERS if name in data}
        for name, value in counters.items():
            if not isinstance(value, int) or not 0 <= value < 2**53:
                raise OutputError(f"{name} must be an integer")
        _check_policy(tensors.get("policy"))
        most = _size(tensors["policy"])
        spaces = {
            name: space_from_json(described[name], most)
            for name in ("observation_space", "action_space")
        }
    except OutputError as error:
        raise OutputError(f"{file} is damaged: {error}") from None
    except Exception as error:  # zip, zlib and torch fail in many ways, and spaces may be anything
        raise OutputError(f"{file} is damaged: {type(error).__name__}: {error}") from None
    return Weights(**spaces, parameters=tensors, variables=dict(variables), counters=counters)


def policy_arguments(settings: Settings) -> dict[str, Any]:
    """Return the arguments of a policy's class in Stable-Baselines3."""
    nn = require("torch", extra="train", purpose="Training a policy").nn
    activation = {"tanh": nn.Tanh, "relu": nn.ReLU, "elu": nn.ELU}[settings.activation]
    return {"net_arch": list(settings.net), "activation_fn": activation, **settings.policy}


def build_policy(settings: Settings, weights: Weights, file: Path) -> Any:
    """Build the `BasePolicy` that the settings describe, with the weights of a file."""
    check_size(settings, weights, file)
    sb3 = require("stable_baselines3", extra="train", purpose="Reading a policy")
    try:
        arguments = policy_arguments(settings)
        if settings.algorithm != "td3":
            arguments["use_sde"] = bool(settings.arguments.get("use_sde", False))
        policy = getattr(sb3, settings.algorithm).MlpPolicy(
            weights.observation_space, weights.action_space, lambda _: 0.0, **arguments
        )
        policy.load_state_dict(weights.parameters["policy"])
    except Exception as error:  # settings may be anything
        raise OutputError(f"{_not_of_settings(file)}: {error}") from None
    policy.set_training_mode(False)
    return policy


def check_size(settings: Settings, weights: Weights, file: Path) -> None:
    """Check that settings describe a net no larger than the weights, before it is made."""
    state = weights.parameters["policy"]
    widths = [*settings.net, *_integers(settings.policy)]
    sizes = [*widths, *(a * b for a, b in itertools.pairwise(widths))]
    if len(widths) > len(state) or max(sizes, default=0) > _size(state):
        raise OutputError(f"{_not_of_settings(file)}: they ask for a net of {widths[:8]}")


def _integers(value: object) -> list[int]:
    """Return the integers within a value, such as `net_arch` and `n_critics` of a policy."""
    if isinstance(value, Mapping):
        value = list(value.values())
    if isinstance(value, (list, tuple)):
        return [found for item in value for found in _integers(item)]
    return [value] if isinstance(value, int) else []


def _not_of_settings(file: Path) -> str:
    return f"{file} is not the policy of its settings; it is damaged, or of another run"


def check_spaces(policy: Any, env: Any, where: Path, env_id: str) -> None:
    """Check that one or several environments have the observations and actions of a policy."""
    for name in ("observation", "action"):
        expected = getattr(policy, f"{name}_space")
        space = getattr(env, f"single_{name}_space", None) or getattr(env, f"{name}_space")
        if expected.shape != space.shape or type(expected) is not type(space):
            raise InputError(
                f"the {name}s of {env_id} must be those of the policy {where}, {expected}, got "
                f"{space}"
            )


def _entry(archive: zipfile.ZipFile, name: str) -> bytes:
    entry = archive.getinfo(name)
    if entry.file_size > max(_LARGEST_ENTRY, _LARGEST_RATIO * entry.compress_size):
        raise OutputError(f"{name} is larger than anything that belongs there")
    return archive.read(name)


def _tensors(content: bytes) -> Any:
    """Read a file of PyTorch if it contains only tensors and plain values."""
    torch = require("torch", extra="train", purpose="Reading a policy")
    try:
        # PyTorch's older formats are not zip files, and were not safe to read in older versions.
        if not content.startswith(b"PK"):
            raise pickle.UnpicklingError
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about the content of an untrusted file
            return torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
    except pickle.UnpicklingError:
        raise OutputError("it holds more than numbers") from None


def _check_policy(state: object) -> None:
    """Check that a policy's weights are finite numbers by name."""
    torch = require("torch", extra="train", purpose="Reading a policy")
    if not isinstance(state, dict) or not state:
        raise OutputError("it contains no weights of a policy")
    for name, value in state.items():
        # A tensor that is not contiguous may be far larger than the file.
        plain = isinstance(value, torch.Tensor) and value.layout == torch.strided
        if not plain or not value.is_contiguous() or not value.is_floating_point():
            raise OutputError(f"{str(name)[:50]!r} must be an array of numbers")
        if not bool(torch.isfinite(value).all()):
            raise OutputError(f"{str(name)[:50]!r} must be finite numbers")


def _size(state: Mapping[str, Any]) -> int:
    return sum(tensor.numel() for tensor in state.values())


# Spaces: {"type": "Box", "shape": [3], "dtype": "float32", "low": [...], "high": [...]}


def add_spaces(file: Path, model: Any) -> None:
    """Add the spaces of a model to its file, where Stable-Baselines3 ignores them."""
    spaces = {name: getattr(model, name) for name in ("observation_space", "action_space")}
    with zipfile.ZipFile(file, "a") as archive:
        described = {name: space_as_json(space) for name, space in spaces.items()}
        archive.writestr(_SPACES, json.dumps(described))


def space_as_json(space: Any) -> dict[str, Any]:
    """Return a Gymnasium space as plain values."""
    kind = type(space).__name__
    if kind == "Discrete":
        return {"type": kind, "n": int(space.n), "start": int(space.start)}
    described: dict[str, Any] = {"type": kind, "shape": list(space.shape)}
    if kind == "Box":
        described["dtype"] = str(space.dtype)
        for name in ("low", "high"):  # as strings: JSON has no infinity
            described[name] = [repr(float(value)) for value in getattr(space, name).flat]
    elif kind == "MultiDiscrete":
        described["nvec"] = space.nvec.ravel().tolist()
    return described


def space_from_json(described: Mapping[str, Any], most: int) -> Any:
    """Return the Gymnasium space that `space_as_json` described.

    Raises:
        ValueError: it is not a space, or has more than `most` numbers, the weights of the policy.
    """
    spaces = require("gymnasium.spaces", extra="train", purpose="Reading a policy")
    kind = described["type"]
    if kind == "Discrete":
        n, start = int(described["n"]), int(described["start"])
        if not 0 < n <= most or abs(start) > 2**31:
            raise ValueError(f"a space of {n} actions")
        return spaces.Discrete(n, start=start)
    shape = tuple(int(length) for length in described["shape"])
    if min(shape, default=1) < 1 or math.prod(shape) > most:
        raise ValueError(f"a space of shape {shape[:8]}")
    if kind == "Box":
        dtype = np.dtype(described["dtype"])
        if dtype.kind not in "fiu":
            raise ValueError(f"a space of {dtype}")
        low, high = (
            np.array([float(value) for value in described[name]]).reshape(shape).astype(dtype)
            for name in ("low", "high")
        )
        if not (low <= high).all():
            raise ValueError("a space with bounds in the wrong order")
        return spaces.Box(low, high, shape, dtype.type)
    if kind == "MultiDiscrete":
        nvec = np.array([int(n) for n in described["nvec"]]).reshape(shape)
        if nvec.min() < 1 or nvec.sum() > most:
            raise ValueError(f"a space of {nvec.sum()} actions")
        return spaces.MultiDiscrete(nvec)
    if kind == "MultiBinary":
        return spaces.MultiBinary(shape[0] if len(shape) == 1 else shape)
    raise ValueError(f"an unknown space {str(kind)[:50]!r}")
