"""Exported policies: the same actions, from the same observations."""

import errno
import json
from pathlib import Path

import gymnasium as gym
import numpy as np
import onnx
import pytest
from onnx.reference import ReferenceEvaluator
from safetensors.numpy import load_file

from mjgranular.errors import InputError, OutputError
from mjgranular.learn.onnx import export_onnx, export_safetensors
from mjgranular.learn.policies import Policy, load_policy
from mjgranular.learn.run import begin_run
from mjgranular.learn.settings import change, find_settings
from mjgranular.learn.train import train

QUICK = {
    "ppo": ("n_steps=64", "batch_size=64", "n_epochs=1", "activation=elu"),
    "sac": ("learning_starts=100", "train_freq=8", "gradient_steps=1", "net=[16, 8]"),
    "td3": ("learning_starts=100", "train_freq=8", "gradient_steps=1", "net=[16, 8]"),
}


def trained(folder, algorithm: str, *changes: str) -> Policy:
    settings = change(
        find_settings("Pendulum-v1", algorithm=algorithm),
        ("num_envs=2", "total_steps=256", *QUICK[algorithm], *changes),
    )
    run = begin_run(folder / "run", "Pendulum-v1", settings, seed=0)
    train(run)
    return load_policy(run.path)


def from_numbers(file):
    """Return a function that acts by the operations and numbers of a file of safetensors."""
    tensors, described = load_file(file), json.loads(file.with_suffix(".json").read_text())
    does = {
        "Sub": np.subtract, "Div": np.divide, "Mul": np.multiply, "Add": np.add, "Clip": np.clip,
        "Max": np.maximum, "Min": np.minimum, "Tanh": np.tanh, "Relu": lambda x: np.maximum(x, 0),
        "Elu": lambda x: np.where(x > 0, x, np.expm1(np.minimum(x, 0))),
        "Gemm": lambda x, weight, bias: x @ weight.T + bias,
    }  # fmt: skip

    def act(observations):
        x = observations.astype(np.float32)
        for i, name in enumerate(described["operations"]):
            x = does[name](x, *(tensors[key] for key in (f"{i}.0", f"{i}.1") if key in tensors))
        return x

    return act


def check_actions(policy: Policy, file) -> None:
    """Drive an environment's observations through all three."""
    model = ReferenceEvaluator(onnx.load(file))
    by_hand = from_numbers(export_safetensors(policy, file.with_suffix(".safetensors")))
    observations: list[np.ndarray] = []
    with gym.make(policy.run.environment) as env:
        observations.append(env.reset(seed=1)[0])
        for _ in range(50):
            (action,) = model.run(None, {"observations": observations[-1][None].astype("f4")})
            assert env.action_space.contains(action[0])
            observations.append(env.step(action[0])[0])
    rows = np.stack(observations)
    (actions,) = model.run(None, {"observations": rows.astype(np.float32)})
    expected = policy.act(rows, np.arange(len(rows)))
    np.testing.assert_allclose(actions, expected, atol=2e-5)
    np.testing.assert_allclose(by_hand(rows), expected, atol=2e-5)


@pytest.mark.parametrize(
    ("algorithm", "changes"),
    [
        ("ppo", ()),
        ("ppo", ("normalize_observations=false",)),
        ("ppo", ("use_sde=true", "policy.squash_output=true")),
        ("sac", ()),
        ("td3", ()),
    ],
)
def test_a_model_acts_as_its_policy(algorithm, changes, tmp_path):
    policy = trained(tmp_path, algorithm, *changes)
    check_actions(policy, export_onnx(policy, tmp_path / "policy.onnx"))


def test_the_go1s_policy_can_be_exported(tmp_path):
    file = export_onnx(load_policy("Go1Velocity-v0/ppo-0"), tmp_path / "go1.onnx")
    graph = onnx.load(file).graph
    shapes = [end.type.tensor_type.shape.dim for end in (graph.input[0], graph.output[0])]
    assert [(shape[0].dim_param, shape[1].dim_value) for shape in shapes] == [("n", 47), ("n", 12)]


def test_nothing_is_overwritten(tmp_path):
    file = tmp_path / "policy.onnx"
    file.write_text("mine")
    with pytest.raises(OutputError, match="exists"):
        export_onnx(load_policy("Hopper-v0/ppo-0"), file)
    with pytest.raises(OutputError, match="exists"):
        export_safetensors(load_policy("Hopper-v0/ppo-0"), file)
    described = tmp_path / "other.json"
    described.write_text("mine")
    with pytest.raises(OutputError, match="exists"):
        export_safetensors(load_policy("Hopper-v0/ppo-0"), tmp_path / "other.safetensors")
    with pytest.raises(InputError, match=r"use \.safetensors"):
        export_safetensors(load_policy("Hopper-v0/ppo-0"), tmp_path / "third.json")
    assert file.read_text() == described.read_text() == "mine"
    assert len(list(tmp_path.iterdir())) == 2


def test_a_full_disk_leaves_no_file(tmp_path, monkeypatch):
    policy = load_policy("Hopper-v0/ppo-0")

    def write(path, content):
        with path.open("wb") as file:
            file.write(content[:100])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", write)
    with pytest.raises(OutputError, match="No space left"):
        export_onnx(policy, tmp_path / "policy.onnx")
    assert not list(tmp_path.iterdir())


def test_what_cannot_be_exported_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"takes a Policy.*load_policy"):
        export_onnx("Hopper-v0/ppo-0", tmp_path / "policy.onnx")  # pyright: ignore
    policy = trained(tmp_path, "sac", "use_sde=true")
    with pytest.raises(InputError, match="cannot be exported"):
        export_onnx(policy, tmp_path / "policy.onnx")
    with pytest.raises(OutputError, match="missing"):
        export_onnx(load_policy("Hopper-v0/ppo-0"), tmp_path / "missing" / "policy.onnx")
    assert [each.name for each in tmp_path.iterdir()] == ["run"]
