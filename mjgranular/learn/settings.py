"""Settings of a training: read from TOML files, changed on the command line, checked."""

import inspect
import tomllib
import typing
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Self

from mjgranular._util.checks import check_count, check_name, require
from mjgranular._util.io import fits, place, read_file
from mjgranular._util.parse import parse_number
from mjgranular.errors import InputError, MissingExtraError, UnknownNameError, shown
from mjgranular.medium.file import check_mapping

ALGORITHMS = ("ppo", "sac", "td3")
ACTIVATIONS = ("tanh", "relu", "elu")
FOLDER = Path(__file__).resolve().parent / "settings"
_TABLES = ("arguments", "policy", "environment")
_LARGEST_FILE = 20_000  # bytes; chosen, ten times what settings need
_MOST_STEPS = 10**12  # chosen: weeks of the fastest simulation
_MOST_ENVS = 2**16  # chosen
_LINEAR = "linear_"
_SCHEDULES = ("learning_rate", "clip_range", "clip_range_vf")  # may fall during the training
_NOT_SETTINGS = (  # arguments of algorithms that the run determines
    "self", "policy", "env", "policy_kwargs", "seed", "verbose", "device", "tensorboard_log",
    "_init_setup_model",
)  # fmt: skip
_KINDS: dict[Any, str] = {
    int: "an integer", float: "a number", bool: "true or false", str: "a string",
    str | None: "a string",
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of a training.

    Attributes:
        algorithm: ppo, sac or td3, those of Stable-Baselines3.
        total_steps: steps of all environments together.
        num_envs: environments that are stepped together.
        net: widths of the hidden layers, of the policy and of the critic.
        activation: between layers: tanh, relu or elu.
        normalize_observations: by their running mean and variance, which are saved with the policy.
        normalize_rewards: by the running variance of the return, in training only.
        checkpoint_every: steps from one checkpoint to the next.
        start_from: the policy to continue from, with its scales of observations: the folder of a
            run or the name of a policy of the package; None or "" for random weights. It also sets
            the noise, unless `policy` has `log_std_init`. PPO: observations that it has not got
            must be the last; their weights begin at zero.
        arguments: arguments of the algorithm's class. A learning rate or clip range "linear_3e-4"
            falls from there to zero; `action_noise` is the standard deviation of normal noise.
        policy: further arguments of the algorithm's policy, such as `log_std_init`.
        environment: arguments of `gymnasium.make`.
    """

    algorithm: str
    total_steps: int
    num_envs: int
    net: tuple[int, ...] = (64, 64)
    activation: str = "tanh"
    normalize_observations: bool = True
    normalize_rewards: bool = True
    checkpoint_every: int = 50_000
    start_from: str | None = None
    arguments: Mapping[str, Any] = field(default_factory=dict)
    policy: Mapping[str, Any] = field(default_factory=dict)
    environment: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.start_from == "":
            object.__setattr__(self, "start_from", None)
        for name, kind in typing.get_type_hints(type(self)).items():
            value = getattr(self, name)
            if name in _TABLES:
                if not isinstance(value, Mapping) or not all(str(k).isidentifier() for k in value):
                    raise InputError(f"{name} must be a table of values by names without dots")
            elif name == "net":
                if not fits(value, kind) or any(width < 1 for width in value):
                    raise InputError(
                        f"net must be widths of layers such as [64, 64], got {shown(value)}"
                    )
            elif not fits(value, kind):
                raise InputError(f"{name} must be {_KINDS[kind]}, got {shown(value)}")
        for name, known in (("algorithm", ALGORITHMS), ("activation", ACTIVATIONS)):
            check_name(name, getattr(self, name), known)
        most = {"num_envs": _MOST_ENVS, "total_steps": _MOST_STEPS, "checkpoint_every": _MOST_STEPS}
        for name, limit in most.items():
            check_count(name, getattr(self, name), most=limit)
        _check_arguments(self.algorithm, self.arguments)
        if self.algorithm == "ppo":
            steps = self.arguments.get("n_steps", 2048) * self.num_envs
            batch = self.arguments.get("batch_size", 64)
            if batch < 2 or steps % batch:
                raise InputError(
                    f"batch_size must divide the {steps} steps of a rollout (n_steps times "
                    f"num_envs), got {batch}"
                )

    def as_json(self) -> dict[str, Any]:
        return {**asdict(self), "net": list(self.net)}

    @classmethod
    def from_json(cls, content: object) -> Self:
        """Return the settings of which `as_json` made `content`."""
        if not isinstance(content, Mapping):
            raise InputError("settings must be an object")
        content = {name: value for name, value in content.items() if name != "processes"}  # 0.2
        check_mapping(content, "settings", [entry.name for entry in fields(cls)])
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
        file: file to read, with `algorithm`, a table `[environment]`, and one for each algorithm;
            or an id, for the settings of that environment; None for those of this, or the default.

    Raises:
        InputError: the file cannot be read, or has a wrong key or value.
        UnknownNameError: no such algorithm, or the file has no table for it.
    """
    named = settings_file(str(file or env_id))
    if file is None or (named.stem != "default" and not file.exists()):
        file = named
    where, read = place(file), read_file(file, "the settings", largest=_LARGEST_FILE)
    try:
        content = tomllib.loads(read.decode())
    except (ValueError, RecursionError) as error:
        raise InputError(f"{where} is not TOML: {error}") from None
    check_mapping(content, where, ("algorithm", "environment", *ALGORITHMS))
    present = [name for name in ALGORITHMS if name in content]
    name = (algorithm or str(content.get("algorithm", ""))).lower()
    if name not in present:
        hint = f"{where} has settings for {', '.join(present)}; --settings FILE.toml names another"
        raise UnknownNameError("algorithm", name, ALGORITHMS, hint)
    table = content[name]
    known = {entry.name for entry in fields(Settings)} - {"algorithm", "environment"}
    check_mapping(table, f"{where}, [{name}]", sorted(known))
    environment = content.get("environment", {})
    try:
        return Settings.from_json({**table, "algorithm": name, "environment": environment})
    except InputError as error:
        raise InputError(f"{where}, [{name}]: {error}") from None


def change(settings: Settings, changes: Sequence[str] | str) -> Settings:
    """Return settings with some values changed.

    Args:
        settings: the initial settings.
        changes: one or several `name=value` as in TOML, strings without quotes; name is a field of
            the settings, an argument of the algorithm, `policy.NAME` or `environment.NAME`.

    Raises:
        InputError: a change of another form, an unknown name or a wrong type.
    """
    direct = {entry.name for entry in fields(Settings)} - {"algorithm", *_TABLES}
    changed: dict[str, Any] = {name: dict(getattr(settings, name)) for name in _TABLES}
    for text in [changes] if isinstance(changes, str) else changes:
        name, equals, value = text.partition("=")
        name = name.strip()
        if not equals or not name:
            raise InputError(f"a change of the settings must be NAME=VALUE, got {shown(text)}")
        parsed = toml_value(value)
        table, dot, key = name.partition(".")
        if dot and table in _TABLES:
            changed[table][key] = parsed
        elif name in direct:
            changed[name] = tuple(parsed) if name == "net" and isinstance(parsed, list) else parsed
        else:
            changed["arguments"][name] = parsed
    return replace(settings, **changed)


def settings_file(env_id: str) -> Path:
    """Return the file with the settings that come with the package for an environment."""
    # `module:namespace/Name-v0` is Gymnasium's way to name an environment of a module.
    name = env_id.rpartition(":")[2]
    file = FOLDER / f"{name}.toml"
    return file if file.is_file() and file.is_relative_to(FOLDER) else FOLDER / "default.toml"


def toml_value(text: str) -> Any:
    """Parse a TOML value, or None; another bare word is a string."""
    try:
        return None if text.strip() == "None" else tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):
        return text.strip()


def algorithm_class(name: str) -> Any:
    """Return the class of an algorithm in Stable-Baselines3."""
    module = require("stable_baselines3", extra="train", purpose="Training a policy")
    return getattr(module, name.upper())


def linear_start(value: object) -> float | None:
    """Return the start of a value that falls to zero: 3e-4 of "linear_3e-4"; None for others."""
    if isinstance(value, str) and value.startswith(_LINEAR):
        return parse_number(value.removeprefix(_LINEAR))
    return None


def _check_arguments(algorithm: str, arguments: Mapping[str, Any]) -> None:
    """Check arguments against the algorithm's class, by name and by type, where there is one."""
    try:
        signature = inspect.signature(algorithm_class(algorithm).__init__).parameters
    except MissingExtraError:
        return  # runs can be listed without it, and no more
    names = [name for name in signature if name not in _NOT_SETTINGS]
    for name, value in arguments.items():
        if name not in names:
            raise InputError(
                f"{algorithm} has no argument {shown(name)}; it has: {', '.join(names)}"
            )
        if name in _SCHEDULES and linear_start(value) is not None:
            continue
        kind = float if name == "action_noise" else signature[name].annotation
        if not fits(value, kind):
            members = typing.get_args(kind) or (kind,)
            words = " or ".join(_KINDS[member] for member in members if member in _KINDS)
            raise InputError(f"{algorithm}: {name} must be {words}, got {shown(value)}")
