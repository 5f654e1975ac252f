"""Policy files, read as data: weights and spaces, without unpickling.

A policy is a zip file of Stable-Baselines3. It holds tensors, which PyTorch reads without executing
anything, and an entry `data`, half of which are pickles. What these contain follows from the
settings of the run, except for the spaces, which are added to the file as JSON.
"""

import io
import json
import pickle
import warnings
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mjgranular._util.checks import require
from mjgranular.errors import InputError, OutputError
from mjgranular.learn.settings import Settings

_SPACES = "spaces.json"
_TENSORS = ".pth"
_COUNTERS = ("num_timesteps", "_n_updates", "_episode_num")


@dataclass(frozen=True)
class Weights:
    """Content of a file of Stable-Baselines3."""

    observation_space: Any  # Gymnasium space of the observations
    action_space: Any  # Gymnasium space of the actions
    parameters: Mapping[str, Any]  # state dictionaries: "policy", "policy.optimizer",
    variables: Mapping[str, Any]  # further tensors, by name
    counters: Mapping[str, int]  # integers of the algorithm, by name


def read_weights(file: Path) -> Weights:
    """Read a file of Stable-Baselines3 with spaces; execute nothing in it."""
    if not file.is_file():
        raise OutputError(f"{file} cannot be read: there is no such file")
    try:
        with zipfile.ZipFile(file) as archive:
            data, described = (json.loads(archive.read(name)) for name in ("data", _SPACES))
            tensors = {
                name.removesuffix(_TENSORS): _tensors(archive.read(name))
                for name in archive.namelist()
                if name.endswith(_TENSORS)
            }
        return Weights(
            observation_space=space_from_json(described["observation_space"]),
            action_space=space_from_json(described["action_space"]),
            variables=dict(tensors.pop("pytorch_variables", None) or {}),
            parameters=tensors,
            counters={name: int(data[name]) for name in _COUNTERS if name in data},
        )
    except OutputError as error:
        raise OutputError(f"{file} is damaged: {error}") from None
    except Exception as error:  # zip, zlib and torch fail in many ways, and spaces may be anything
        raise OutputError(f"{file} is damaged: {type(error).__name__}: {error}") from None


def policy_arguments(settings: Settings) -> dict[str, Any]:
    """Return the arguments of a policy's class in Stable-Baselines3."""
    nn = require("torch", extra="train", purpose="Training a policy").nn
    activation = {"tanh": nn.Tanh, "relu": nn.ReLU, "elu": nn.ELU}[settings.activation]
    return {"net_arch": list(settings.net), "activation_fn": activation, **settings.policy}


def build_policy(settings: Settings, weights: Weights, file: Path) -> Any:
    """Build the `BasePolicy` that the settings describe, with the weights of a file."""
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
        raise OutputError(
            f"{file} is not the policy of its settings; it is damaged, or of another run: {error}"
        ) from None
    policy.set_training_mode(False)
    return policy


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


def _tensors(content: bytes) -> Any:
    """Read a file of PyTorch if it contains only tensors and plain values."""
    torch = require("torch", extra="train", purpose="Reading a policy")
    try:
        # PyTorch's older formats are not zip files, and were not safe to read in older versions.
        if not content.startswith(b"PK"):
            raise pickle.UnpicklingError
        with warnings.catch_warnings(action="ignore"):  # about the content of an untrusted file
            return torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
    except pickle.UnpicklingError:
        raise OutputError("it holds more than numbers") from None


# Spaces: {"type": "Box", "shape": [3], "dtype": "float32", "low": [...], "high": [...]}


def add_spaces(file: Path, model: Any) -> None:
    """Add the spaces of a model to its file, where Stable-Baselines3 ignores them."""
    names = ("observation_space", "action_space")
    described = {name: space_as_json(getattr(model, name)) for name in names}
    with zipfile.ZipFile(file, "a") as archive:
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


def space_from_json(described: Mapping[str, Any]) -> Any:
    """Return the Gymnasium space that `space_as_json` described."""
    spaces = require("gymnasium.spaces", extra="train", purpose="Reading a policy")
    kind = described["type"]
    if kind == "Discrete":
        return spaces.Discrete(described["n"], start=described["start"])
    shape = tuple(described["shape"])
    if kind == "Box":
        dtype = np.dtype(described["dtype"])
        low, high = (
            np.array([float(value) for value in described[name]]).reshape(shape).astype(dtype)
            for name in ("low", "high")
        )
        return spaces.Box(low, high, shape, dtype.type)
    if kind == "MultiDiscrete":
        return spaces.MultiDiscrete(np.array(described["nvec"]).reshape(shape))
    if kind == "MultiBinary":
        return spaces.MultiBinary(shape[0] if len(shape) == 1 else shape)
    raise ValueError(f"an unknown space {str(kind)[:50]!r}")
