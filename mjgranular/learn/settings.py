"""Settings of a training: read from TOML files, changed on the command line, checked."""

from __future__ import annotations

import inspect
import tomllib
import typing
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from mjgranular._util.extras import require
from mjgranular._util.io import place, read_file
from mjgranular._util.io import fits
from mjgranular.errors import InputError, UnknownNameError, shown

ALGORITHMS = ("ppo", "sac", "td3")
ACTIVATIONS = ("tanh", "relu", "elu")
LARGEST = 20_000
"""Size up to which a file is read [bytes]; chosen, ten times what settings need. A dotted key costs
the square of its length."""

FOLDER = Path(__file__).resolve().parent / "settings"
_GIVEN_BY_US = (
    "self",
    "policy",
    "env",
    "policy_kwargs",
    "seed",
    "verbose",
    "device",
    "tensorboard_log",
    "_init_setup_model",
)
_TABLES = ("arguments", "policy", "environment")
_MOST = 10**12  # limit of steps and environments; chosen: weeks of the fastest simulation
_LINEAR = "linear_"
_MOST_ENVS = 2**16  # more than anyone steps together; chosen
_FAR = 100_000  # divisors of the steps are searched this far from the batch size
_SCHEDULES = ("learning_rate", "clip_range", "clip_range_vf")  # may fall during the training


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of a training.

    Attributes:
        algorithm: ppo, sac or td3, those of Stable-Baselines3.
        total_steps: steps of all environments together.
        num_envs: environments that are stepped together.
        processes: whether each of them is stepped in a separate process; for environments that
            mjgranular does not step in one batch.
        net: widths of the hidden layers, of the policy and of the critic.
        activation: between layers: tanh, relu or elu.
        normalize_observations: by their running mean and variance, which are saved with the policy.
        normalize_rewards: by the running variance of the return, in training only.
        checkpoint_every: steps from one checkpoint to the next.
        arguments: arguments of the algorithm's class. A learning rate or clip range "linear_3e-4"
            falls from there to zero; `action_noise` is the standard deviation of normal noise.
        policy: further arguments of the algorithm's policy, such as `log_std_init`.
        environment: arguments of `gymnasium.make`.
    """

    algorithm: str
    total_steps: int
    num_envs: int
    processes: bool = False
    net: tuple[int, ...] = (64, 64)
    activation: str = "tanh"
    normalize_observations: bool = True
    normalize_rewards: bool = True
    checkpoint_every: int = 50_000
    arguments: Mapping[str, Any] = field(default_factory=dict)
    policy: Mapping[str, Any] = field(default_factory=dict)
    environment: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("algorithm", "activation"):
            if not isinstance(getattr(self, name), str):
                raise InputError(f"{name} must be a text")
        if self.algorithm not in ALGORITHMS:
            raise UnknownNameError("algorithm", self.algorithm, ALGORITHMS)
        if self.activation not in ACTIVATIONS:
            raise UnknownNameError("activation", self.activation, ACTIVATIONS)
        for name in ("total_steps", "num_envs", "checkpoint_every"):
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or not 1 <= value <= _MOST:
                raise InputError(
                    f"{name} must be a whole number of at least 1 and at most {_MOST:g}, not "
                    f"{shown(value)}"
                )
        if self.num_envs > _MOST_ENVS:
            raise InputError(f"num_envs must be at most {_MOST_ENVS}, not {self.num_envs}")
        for name in ("processes", "normalize_observations", "normalize_rewards"):
            if not isinstance(getattr(self, name), bool):
                raise InputError(f"{name} must be true or false, not {shown(getattr(self, name))}")
        if not isinstance(self.net, tuple) or not all(
            isinstance(w, int) and not isinstance(w, bool) and w > 0 for w in self.net
        ):
            raise InputError(
                f"net must be widths of layers such as [64, 64], not {shown(self.net)}"
            )
        for name in _TABLES:
            if not isinstance(getattr(self, name), Mapping):
                raise InputError(f"{name} must be a table of names and values")
            if not all(isinstance(key, str) and key.isidentifier() for key in getattr(self, name)):
                raise InputError(f"{name} must be a table of names and values")
        _check_arguments(self.algorithm, self.arguments)
        if self.algorithm == "ppo":
            self._check_batches()

    def _check_batches(self) -> None:
        steps = self.arguments.get("n_steps", 2048) * self.num_envs
        batch = self.arguments.get("batch_size", 64)
        if batch < 2 or steps % batch:
            raise InputError(
                f"batch_size {batch} does not divide the {steps} steps of a rollout "
                f"(n_steps times num_envs): {_nearest_divisor(steps, batch)} would"
            )

    def as_json(self) -> dict[str, Any]:
        """Return plain values."""
        return {**asdict(self), "net": list(self.net)}

    @classmethod
    def from_json(cls, content: object) -> Settings:
        """Return the settings of which `as_json` made `content`.

        Raises:
            InputError: `content` is not of that form; says what is wrong.
        """
        if not isinstance(content, Mapping):
            raise InputError("settings must be an object")
        _check_keys("settings", content, [entry.name for entry in fields(cls)])
        missing = [name for name in ("algorithm", "total_steps", "num_envs") if name not in content]
        if missing:
            raise InputError(f"{' and '.join(missing)} must be given")
        net = content.get("net", [64, 64])
        return cls(**{**content, "net": tuple(net) if isinstance(net, list) else net})


def find_settings(
    env_id: str, *, algorithm: str | None = None, file: Path | None = None
) -> Settings:
    """Return the settings for an environment.

    Args:
        env_id: Gymnasium id, such as `mjgranular/ChainSwim-v0`.
        algorithm: None for the one that the file names.
        file: file to read; None for that of the environment or, where there is none, the default.

    Raises:
        InputError: the file cannot be read, or has a wrong key or value in it; says which.
        UnknownNameError: no such algorithm, or the file has no table for it.
    """
    return read_settings(file or settings_file(env_id), algorithm=algorithm)


def settings_file(env_id: str) -> Path:
    """Return the file with the settings that come with the package for an environment."""
    # `module:namespace/Name-v0` is Gymnasium's way to name an environment of a module.
    identity = env_id.rpartition(":")[2]
    own = FOLDER / f"{identity}.toml"
    return own if own.is_file() and own.is_relative_to(FOLDER) else FOLDER / "default.toml"


def read_settings(file: Path, *, algorithm: str | None = None) -> Settings:
    """Read settings: `algorithm`, a table `[environment]`, and a table for each algorithm.

    Raises:
        InputError: the file cannot be read, or has a wrong key or value in it; says which.
        UnknownNameError: no such algorithm, or the file has no table for it.
    """
    content = _read_toml(file)
    where = place(file)
    _check_keys(where, content, ("algorithm", "environment", *ALGORITHMS))
    present = [name for name in ALGORITHMS if name in content]
    name = (algorithm or str(content.get("algorithm", ""))).lower()
    if name not in ALGORITHMS:
        others = [one for one in ALGORITHMS if one not in present]
        hint = (
            f"{where} has settings for {', '.join(present)}; for {' and '.join(others)} they are "
        )
        hint += "given in a file with a table of that name, --settings FILE.toml"
        raise UnknownNameError("algorithm", name, ALGORITHMS, hint if present and others else "")
    if name not in content:
        raise InputError(
            f"{where} has no table [{name}]; it has settings for {', '.join(present) or 'none'}"
        )
    table = content[name]
    if not isinstance(table, dict):
        raise InputError(f"{where}: {name} must be a table, [{name}]")
    known = {entry.name for entry in fields(Settings)} - {"algorithm", "environment"}
    _check_keys(f"{where}, [{name}]", table, sorted(known))
    environment = content.get("environment", {})
    try:
        return Settings.from_json({**table, "algorithm": name, "environment": environment})
    except UnknownNameError:
        raise
    except InputError as error:
        raise InputError(f"{where}, [{name}]: {error}") from None


def _read_toml(file: Path) -> dict[str, Any]:
    text = read_file(file, "the settings", largest=LARGEST)
    name = place(file)
    try:
        return tomllib.loads(text.decode("utf-8"))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{name} is not TOML: {error}") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{name} is not TOML: byte {error.start} is not UTF-8") from None
    except RecursionError:
        raise InputError(f"{name} is nested too deeply for settings") from None
    except ValueError:  # of an int with thousands of digits
        raise InputError(f"{name} has a number that is too long") from None


def change(settings: Settings, changes: Sequence[str] | str) -> Settings:
    """Return settings with some values changed.

    Args:
        settings: the initial settings.
        changes: one or several `name=value`, where name is a field of the settings (`num_envs=8`),
            an argument of the algorithm (`gamma=0.98`), `policy.name` or `environment.name`; values
            as in TOML, where strings need no quotes.

    Raises:
        InputError: not of this form, an unknown name or a wrong type.
    """
    own = {entry.name for entry in fields(Settings)} - {"algorithm", *_TABLES}
    changed: dict[str, Any] = {name: dict(getattr(settings, name)) for name in _TABLES}
    for text in [changes] if isinstance(changes, str) else changes:
        name, given, value = text.partition("=")
        name = name.strip()
        if not given or not name:
            raise InputError(f"a change of the settings is NAME=VALUE, not {shown(text)}")
        parsed = toml_value(value)
        table, dot, key = name.partition(".")
        if dot and table in _TABLES:
            changed[table][key] = parsed
        elif name in own:
            changed[name] = tuple(parsed) if name == "net" and isinstance(parsed, list) else parsed
        else:
            changed["arguments"][name] = parsed
    return replace(settings, **changed)


def toml_value(text: str) -> Any:
    """Parse a TOML value; a bare word is a string."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):
        return text.strip()


def algorithm_class(name: str) -> Any:
    """Return the class of an algorithm in Stable-Baselines3.

    Raises:
        MissingExtraError: Stable-Baselines3 is not installed.
    """
    module = require("stable_baselines3", extra="train", purpose="Training a policy")
    return getattr(module, name.upper())


def linear_start(value: object) -> float | None:
    """Return the start of a value that falls to zero: 3e-4 of "linear_3e-4"; None for others."""
    if isinstance(value, str) and value.startswith(_LINEAR):
        try:
            return float(value.removeprefix(_LINEAR))
        except ValueError:
            return None
    return None


def _check_keys(where: str, table: Mapping[str, Any], known: Sequence[str]) -> None:
    for key in table:
        if key not in known:
            raise InputError(f"{where}: no key {shown(key)}; there are: {', '.join(known)}")


def _check_arguments(algorithm: str, arguments: Mapping[str, Any]) -> None:
    """Check arguments against the algorithm's class, by name and by type."""
    signature = inspect.signature(algorithm_class(algorithm).__init__).parameters
    names = [name for name in signature if name not in _GIVEN_BY_US]
    for name, value in arguments.items():
        if name not in names:
            raise InputError(
                f"{algorithm} has no argument {shown(name)}; it has: {', '.join(names)}"
            )
        wanted = float if name == "action_noise" else signature[name].annotation
        if name in _SCHEDULES and linear_start(value) is not None:
            continue
        if not fits(value, wanted):
            raise InputError(f"{algorithm}: {name} must be {_words(wanted)}, not {shown(value)}")


def _words(kind: Any) -> str:
    names = {int: "a whole number", float: "a number", bool: "true or false", str: "a text"}
    return " or ".join(
        names[member] for member in typing.get_args(kind) or (kind,) if member in names
    )


def _nearest_divisor(steps: int, batch: int) -> int:
    for away in range(min(steps, _FAR)):
        for divisor in (batch - away, batch + away):
            if 2 <= divisor <= steps and steps % divisor == 0:
                return divisor
    return steps
