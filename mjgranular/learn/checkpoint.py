"""Checkpoints, all that a training needs to resume, and policies: data, read without unpickling."""

import io
import json
import pickle
import warnings
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from mjgranular._util import files
from mjgranular._util.checks import require
from mjgranular._util.io import number, read_arrays, read_json
from mjgranular._util.result_folder import CONFIG
from mjgranular.errors import InputError, OutputError
from mjgranular.learn.run import CURVE, NORMALIZER, POLICY, STATE, Run, curve_text, read_curve
from mjgranular.learn.settings import Settings

# Policy files are zip files of Stable-Baselines3. One holds tensors, which PyTorch reads without
# executing anything, and an entry `data`, half of which are pickles. What these contain follows
# from the settings of the run, except for the spaces, which are added to the file as JSON.

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


# Checkpoints

_REPLAY = "replay.npz"
_KEPT = 2  # checkpoints; the older one in case the newer is damaged
_NUMBERS = ("count", "clip", "epsilon", "return_mean", "return_variance", "return_count")
_REPLAY_ARRAYS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")

# State of the running episodes, which a checkpoint does not keep: see `callback.restart_episodes`.
_EPISODE_STATE = (
    "_last_obs", "_last_original_obs", "_last_episode_starts",
    "ep_info_buffer", "ep_success_buffer",
)  # fmt: skip


@dataclass(frozen=True)
class Progress:
    """Progress of a training."""

    steps: int  # steps of all environments together
    seconds: float  # time spent in training, in all processes together [s]
    curve: Sequence[tuple[float, ...]]  # rows of `run.CURVE_COLUMNS`


def save_checkpoint(run: Run, model: Any, progress: Progress) -> None:
    """Write a checkpoint of an algorithm of Stable-Baselines3 atomically; keep the newest two."""
    tables = {
        CONFIG: run.config(),
        NORMALIZER: Normalizer.of(model.get_vec_normalize_env()).as_json(),
        STATE: {"steps": progress.steps, "seconds": progress.seconds},
    }

    def fill(folder: Path) -> None:
        model.save(folder / POLICY, exclude=_EPISODE_STATE)
        add_spaces(folder / POLICY, model)
        (folder / CURVE).write_text(curve_text(progress.curve), encoding="utf-8")
        if hasattr(model, "replay_buffer"):
            _write_replay(folder / _REPLAY, model.replay_buffer)
        for name, table in tables.items():
            (folder / name).write_text(json.dumps(table, indent=2) + "\n", encoding="utf-8")

    files.write_folder(run.checkpoint_folder(progress.steps), fill)
    for old in run.checkpoints()[_KEPT:]:
        files.remove_folder(old)


def load_checkpoint(
    folder: Path, run: Run, env: Any, make_model: Callable[[], Any]
) -> tuple[Any, Progress]:
    """Return the model and progress of an undamaged checkpoint."""
    normalizer = Normalizer.read(folder / NORMALIZER, run.settings, env.observation_space.shape)
    weights = read_weights(folder / POLICY)
    check_spaces(weights, env, folder, run.environment)
    model = make_model()
    try:
        model.set_parameters(dict(weights.parameters), exact_match=True, device="cpu")
        entropy = weights.variables.get("log_ent_coef")
        if entropy is not None:
            model.log_ent_coef.data = entropy.data.reshape(model.log_ent_coef.shape)
    except Exception as error:  # files of other versions fail in many ways
        raise OutputError(
            f"{folder} cannot be read by the installed packages ({error}); it was written with "
            f"{run.version_names()}"
        ) from None
    for name, value in weights.counters.items():
        setattr(model, name, value)
    if hasattr(model, "replay_buffer"):
        _read_replay(folder / _REPLAY, model.replay_buffer)
    seconds = number(read_json(folder / STATE), "seconds", folder / STATE) or 0.0
    normalizer.restore(env)  # last: the environment is unchanged if anything was wrong
    return model, Progress(model.num_timesteps, seconds, read_curve(folder / CURVE))


def write_policy(run: Run, checkpoint: Path) -> None:
    """Copy what evaluation needs from a checkpoint to the run's folder, atomically."""
    with files.replace_directory(run.path) as waiting:
        for name in (POLICY, NORMALIZER, CURVE):
            (waiting / name).write_bytes((checkpoint / name).read_bytes())


@dataclass(frozen=True)
class Normalizer:
    """Statistics of a `VecNormalize`, which scales observations as it does."""

    observations: bool  # whether observations are scaled
    mean: np.ndarray  # of the observations, shape of one; empty if they are not scaled, as the next
    variance: np.ndarray  # of the observations
    count: float  # number of observations
    clip: float  # largest absolute value of a scaled number
    epsilon: float  # added to the variance
    return_mean: float  # mean of the discounted returns
    return_variance: float  # their variance
    return_count: float  # their number

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        if not self.observations:
            return observations
        scaled = (observations - self.mean) / np.sqrt(self.variance + self.epsilon)
        return np.clip(scaled, -self.clip, self.clip).astype(np.float32)

    @classmethod
    def of(cls, env: Any) -> Self:
        none, returns = np.array([]), env.ret_rms
        mean, variance, count = none, none, 0.0
        if env.norm_obs:
            mean, variance, count = env.obs_rms.mean, env.obs_rms.var, env.obs_rms.count
        numbers = (count, env.clip_obs, env.epsilon, returns.mean, returns.var, returns.count)
        return cls(env.norm_obs, mean, variance, *map(float, numbers))

    def restore(self, env: Any) -> None:
        if self.observations:
            env.obs_rms.mean, env.obs_rms.var = self.mean, self.variance
            env.obs_rms.count = self.count
        env.ret_rms.mean = np.float64(self.return_mean)
        env.ret_rms.var = np.float64(self.return_variance)
        env.ret_rms.count = self.return_count

    def widened(self, size: int) -> Self:
        """Return statistics of more observations, of which the new ones are not scaled at first."""
        more = size - len(self.mean) if self.observations else 0
        return replace(
            self,
            mean=np.concatenate([self.mean, np.zeros(more)]),
            variance=np.concatenate([self.variance, np.ones(more)]),
        )

    def as_json(self) -> dict[str, Any]:
        """Return plain values; floats in JSON read back the same."""
        return {**asdict(self), "mean": self.mean.tolist(), "variance": self.variance.tolist()}

    @classmethod
    def read(cls, file: Path, settings: Settings, shape: tuple[int, ...]) -> Self:
        """Read what `as_json` returned, for observations of a shape."""
        content, scaled = read_json(file), settings.normalize_observations
        try:
            arrays = {name: np.array(content[name], float) for name in ("mean", "variance")}
            numbers: dict[str, Any] = {name: float(content[name]) for name in _NUMBERS}
        except (KeyError, TypeError, ValueError) as error:
            raise OutputError(f"{file} is damaged: {type(error).__name__}: {error}") from None
        expected = shape if scaled else (0,)
        if content.get("observations") is not scaled or any(
            array.shape != expected or not np.isfinite(array).all() for array in arrays.values()
        ):
            raise OutputError(
                f"{file} is damaged, or not of this policy: observations must be {scaled}, mean "
                f"and variance finite numbers of shape {expected}"
            )
        return cls(scaled, arrays["mean"], arrays["variance"], **numbers)


# Replay buffers of SAC and TD3


def _replay_arrays(buffer: Any) -> list[str]:
    return [name for name in _REPLAY_ARRAYS if hasattr(buffer, name)]


def _write_replay(file: Path, buffer: Any) -> None:
    """Write the part of a `ReplayBuffer` that is in use, as arrays."""
    used = len(buffer.rewards) if buffer.full or buffer.optimize_memory_usage else buffer.pos
    arrays = {name: getattr(buffer, name)[:used] for name in _replay_arrays(buffer)}
    with file.open("wb") as stream:
        np.savez(stream, **arrays, pos=buffer.pos, full=buffer.full)


def _read_replay(file: Path, buffer: Any) -> None:
    names = _replay_arrays(buffer)
    arrays = read_arrays(file, [*names, "pos", "full"], most=None)
    used = len(arrays["rewards"])
    try:
        for name in names:
            getattr(buffer, name)[:used] = arrays[name]
        buffer.pos, buffer.full = int(arrays["pos"]), bool(arrays["full"])
    except (TypeError, ValueError) as error:
        raise OutputError(f"{file} is damaged, or of another run: {error}") from None
