"""Files of Stable-Baselines3 read as data: weights and plain values, nothing unpickled.

Such a file is a zip with tensors, which PyTorch can read without executing anything, and an entry
`data`, half of which are pickles. What is in these follows from the settings of the run, so they
are left alone. Only the spaces do not: we add them to the file as JSON; of files without it, those
of version 0.1, shape and bounds are taken from the texts that stand beside the pickles.
"""

from __future__ import annotations

import io
import itertools
import json
import math
import pickle
import re
import warnings
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mjgranular.errors import OutputError
from mjgranular.extras import need
from mjgranular.learn.settings import Settings
from mjgranular.saved import parse_json

SPACES = "spaces.json"
_DATA = "data"
_TENSORS = ".pth"
_VARIABLES = "pytorch_variables"
_COUNTERS = ("num_timesteps", "_n_updates", "_episode_num")
_PURPOSE = "Reading a policy"
_SMALL = 64 * 2**20  # bytes; an entry may unpack to this much, or to
_RATIO = 8  # as many times its size in the file; both chosen
_TYPES = ("float32", "float64", "float16", "int8", "int16", "int32", "int64", "uint8", "uint16")
_NUMBER = re.compile(r"[-+]?(?:inf|\d+\.?\d*(?:e[-+]?\d+)?|\.\d+)", re.IGNORECASE)


@dataclass(frozen=True)
class Weights:
    """Content of a file of Stable-Baselines3, as data.

    Attributes:
        observation_space: of Gymnasium.
        action_space: the same.
        parameters: state by the name of what it is of: "policy", "policy.optimizer", ...
        variables: further tensors, by name.
        counters: whole numbers of the algorithm, by name.
    """

    observation_space: Any
    action_space: Any
    parameters: Mapping[str, Any]
    variables: Mapping[str, Any]
    counters: Mapping[str, int]


def read_weights(file: Path) -> Weights:
    """Reads a file that `Algorithm.save` of Stable-Baselines3 wrote; executes nothing in it.

    Raises:
        OutputError: it cannot be read, or is no such file; says what is wrong.
    """
    if not file.is_file():
        raise OutputError(f"{file} cannot be read: there is no such file")
    try:
        with zipfile.ZipFile(file) as archive:
            names = archive.namelist()
            data = parse_json(_entry(archive, _DATA, file).decode(), f"{_DATA} in {file}")
            tensors = {
                name.removesuffix(_TENSORS): _tensors(_entry(archive, name, file))
                for name in names
                if name.endswith(_TENSORS)
            }
            told: dict[str, Any] = {}
            if SPACES in names:
                told = parse_json(_entry(archive, SPACES, file).decode(), f"{SPACES} in {file}")
    except OutputError:
        raise
    except Exception as error:  # zip, zlib and torch fail in many ways
        raise OutputError(f"{file} is damaged: {brief(error)}") from None
    variables = tensors.pop(_VARIABLES, None)
    counters = {name: data.get(name) for name in _COUNTERS if name in data}
    for name, value in counters.items():
        if not isinstance(value, int) or not 0 <= value < 2**53:
            raise OutputError(f"{file} is damaged: {name} must be a whole number")
    most = sum(tensor.numel() for tensor in _state(tensors.get("policy"), file).values())
    spaces = {}
    for name in ("observation_space", "action_space"):
        try:
            spaces[name] = _space(told.get(name) or _of_text(data[name]), most)
        except Exception as error:  # whatever there is in place of a space
            raise OutputError(f"{file} is damaged: {name}: {brief(error)}") from None
    return Weights(
        spaces["observation_space"],
        spaces["action_space"],
        tensors,
        variables if isinstance(variables, dict) else {},
        counters,  # pyright: ignore[reportArgumentType]
    )


def add_spaces(file: Path, observation_space: Any, action_space: Any) -> None:
    """Adds the spaces to a file of Stable-Baselines3, which does not mind, as plain numbers."""
    told = {
        "observation_space": _as_json(observation_space),
        "action_space": _as_json(action_space),
    }
    with zipfile.ZipFile(file, "a") as archive:
        archive.writestr(SPACES, json.dumps(told))


def policy_arguments(settings: Settings) -> dict[str, Any]:
    """Arguments of a policy's class in Stable-Baselines3."""
    nn = need("torch", extra="train", purpose="Training a policy").nn
    activation = {"tanh": nn.Tanh, "relu": nn.ReLU, "elu": nn.ELU}[settings.activation]
    return {"net_arch": list(settings.net), "activation_fn": activation, **settings.policy}


def new_policy(settings: Settings, observation_space: Any, action_space: Any) -> Any:
    """A fresh policy of Stable-Baselines3 as the settings describe it, a `BasePolicy`."""
    sb3 = need("stable_baselines3", extra="train", purpose=_PURPOSE)
    arguments = policy_arguments(settings)
    if settings.algorithm != "td3":
        arguments["use_sde"] = bool(settings.arguments.get("use_sde", False))
    return getattr(sb3, settings.algorithm).MlpPolicy(
        observation_space, action_space, lambda _: 0.0, **arguments
    )


def build_policy(settings: Settings, weights: Weights, file: Path) -> Any:
    """The policy that the settings describe, with these weights: a `BasePolicy`.

    Args:
        settings: of the run.
        weights: read from a file.
        file: the file, for the message.

    Raises:
        OutputError: weights and settings do not go together.
    """
    check_size(settings, weights, file)
    try:
        policy = new_policy(settings, weights.observation_space, weights.action_space)
        policy.load_state_dict(weights.parameters["policy"])
    except Exception as error:  # settings may be anything
        raise OutputError(
            f"{file} is not the policy of its settings: {brief(error)}; it was written by another "
            "run, or is damaged"
        ) from None
    policy.set_training_mode(False)
    return policy


def check_size(settings: Settings, weights: Weights, file: Path) -> None:
    """Refuses settings of a net that is larger than the weights before it is made.

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
    """Reads what PyTorch saved, if that is tensors and plain values."""
    torch = need("torch", extra="train", purpose=_PURPOSE)
    # Its older kinds of files are not zips, and were not safe to read in older versions.
    if not content.startswith(b"PK"):
        raise pickle.UnpicklingError
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of what a stranger's file may have in it
        return torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)


def _state(state: object, file: Path) -> dict[str, Any]:
    """A policy's weights, if that is what they are: finite numbers by name."""
    torch = need("torch", extra="train", purpose=_PURPOSE)
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
    """Lists of whole numbers within a value."""
    if isinstance(value, Mapping):
        return [found for item in value.values() for found in _lists(item)]
    if isinstance(value, (list, tuple)):
        mine = [item for item in value if isinstance(item, int)]
        return [mine, *(found for item in value for found in _lists(item))]
    return []


# Spaces: {"type": "Box", "shape": [3], "dtype": "float32", "low": [...], "high": [...]}


def _as_json(space: Any) -> dict[str, Any]:
    kind = type(space).__name__
    told: dict[str, Any] = {"type": kind}
    if kind == "Box":
        told |= {"shape": list(space.shape), "dtype": str(space.dtype)}
        # As texts: JSON has no infinity.
        told |= {name: [repr(float(v)) for v in getattr(space, name).flat] for name in _BOUNDS}
    elif kind == "Discrete":
        told |= {"n": int(space.n), "start": int(space.start)}
    elif kind == "MultiDiscrete":
        told |= {"shape": list(space.shape), "nvec": [int(n) for n in space.nvec.flat]}
    elif kind == "MultiBinary":
        told |= {"shape": list(space.shape)}
    return told


_BOUNDS = ("low", "high")


def _of_text(entry: Mapping[str, Any]) -> dict[str, Any]:
    """The same from what version 0.1 wrote: numbers as NumPy prints them."""
    kind = str(entry[":type:"]).rpartition(".")[2].removesuffix("'>")
    told: dict[str, Any] = {"type": kind}
    if kind == "Discrete":
        return told | {"n": int(entry["n"]), "start": int(entry["start"])}
    told["shape"] = entry["_shape"]
    if kind == "Box":
        told |= {"dtype": entry["dtype"], **{name: _numbers(entry[name]) for name in _BOUNDS}}
    elif kind == "MultiDiscrete":
        told["nvec"] = [int(number) for number in _numbers(entry["nvec"])]
    return told


def _numbers(text: str) -> list[str]:
    if "..." in text:
        raise ValueError("its bounds are cut off in the file; train it anew")
    return _NUMBER.findall(text)


def _space(told: Mapping[str, Any], most: int) -> Any:
    """A space of Gymnasium; `most` is more than the numbers that it can have."""
    spaces = need("gymnasium.spaces", extra="train", purpose=_PURPOSE)
    kind = told["type"]
    if kind == "Discrete":
        n, start = int(told["n"]), int(told["start"])
        if not 0 < n <= most or abs(start) > 2**31:
            raise ValueError(f"{n} actions")
        return spaces.Discrete(n, start=start)
    shape = tuple(int(length) for length in told["shape"])
    if any(length < 0 for length in shape) or not 0 < math.prod(shape) <= most:
        raise ValueError(f"a shape of {shape[:8]}")
    if kind == "Box":
        if told["dtype"] not in _TYPES:
            raise ValueError("its numbers are of no known type")
        low, high = (
            np.array([float(v) for v in told[name]]).reshape(shape).astype(told["dtype"])
            for name in _BOUNDS
        )
        if not (low <= high).all():
            raise ValueError("its bounds are the wrong way round")
        return spaces.Box(low, high, shape, np.dtype(told["dtype"]).type)
    if kind == "MultiDiscrete":
        nvec = np.array([int(n) for n in told["nvec"]]).reshape(shape)
        if not (nvec > 0).all() or nvec.sum() > most:
            raise ValueError(f"{nvec.sum()} actions")
        return spaces.MultiDiscrete(nvec)
    if kind == "MultiBinary":
        return spaces.MultiBinary(shape[0] if len(shape) == 1 else shape)
    raise ValueError(f"there is no space {str(kind)[:50]!r}")


def brief(error: Exception) -> str:
    """An error of a library in a few words."""
    if isinstance(error, pickle.UnpicklingError):
        return "it holds more than numbers, or what is none"
    text = "".join(c if c.isprintable() else " " for c in str(error))
    text = " ".join(text.split())[:200]
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
