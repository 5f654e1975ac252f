"""Export policies to ONNX and safetensors, for robots and other simulators."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from mjgranular._util.checks import check_kind, require
from mjgranular._util.files import atomic_write, write_text
from mjgranular.errors import InputError, OutputError
from mjgranular.learn.policies import Policy

_OPSET, _FORMAT = 17, 8  # of ONNX and of the file; ONNX Runtime reads them since 1.12
_ACTIVATIONS = {"Tanh": "Tanh", "ReLU": "Relu", "ELU": "Elu"}  # PyTorch's names, ONNX's
_TOLERANCE = 1e-5  # of actions, in units of their range; weights are in single precision


def export_onnx(policy: Policy, file: str | Path) -> Path:
    """Write a policy as an ONNX model: from observations to actions, without noise.

    The model has one input, `observations`, float32 of shape (n, observations), as the environment
    gives them: scaling them is part of the model. Its output, `actions`, float32 of shape
    (n, actions), is what `step` takes. Before the file is written, actions for 64 observations are
    compared with those of `policy.act`. The file must not exist yet.

    Raises:
        MissingExtraError: the extra `onnx` is not installed.
        InputError: observations or actions are not rows of numbers, or a layer is unknown.
        OutputError: the file exists or cannot be written, or actions differ.
    """
    onnx = require("onnx", extra="onnx", purpose="Exporting a policy")
    reference = require("onnx.reference", extra="onnx", purpose="Exporting a policy")
    file = _check(policy, file)
    model = _model_of(onnx, policy)
    # Observations that reach the limits of scaled observations and of actions.
    shape = (64, *policy.model.observation_space.shape)
    values = 4 * np.random.default_rng(0).standard_normal(shape)
    if policy.normalizer.observations:
        values = policy.normalizer.mean + np.sqrt(policy.normalizer.variance) * values
    observations = values.astype(np.float32)
    (actions,) = reference.ReferenceEvaluator(model).run(None, {"observations": observations})
    space = policy.model.action_space
    expected = policy.act(observations, np.zeros(len(observations)))
    error = float((np.abs(actions - expected) / (space.high - space.low)).max())
    if not error < _TOLERANCE:
        raise OutputError(f"{file} was not written: its actions would be off by {error:.1g}")
    with atomic_write(file) as part:
        part.write_bytes(model.SerializeToString())
    return file


def export_safetensors(policy: Policy, file: str | Path) -> Path:
    """Write the numbers of a policy as safetensors, and what they are as JSON beside them.

    The JSON file has the same name with the suffix .json: the environment, its sand, versions, and
    `operations`, a list of names of ONNX operators in their order, from observations to actions.
    Constants of operation i are the tensors "i.0", "i.1"; those of a `Gemm` are weight and bias.

    Raises: as `export_onnx`.
    """
    tensors = require("safetensors.numpy", extra="onnx", purpose="Exporting a policy")
    file = _check(policy, file)
    if file.suffix == ".json":
        raise InputError(f"{file} is the name of the JSON file: use .safetensors")
    described = _check(policy, file.with_suffix(".json"))
    operations = _operations_of(policy)
    numbers = {
        f"{i}.{k}": np.ascontiguousarray(value)
        for i, (_, values) in enumerate(operations)
        for k, value in enumerate(values)
    }
    content = policy.run.config() | {"operations": [name for name, _ in operations]}
    with atomic_write(file) as part:
        part.write_bytes(tensors.save(numbers))
    write_text(described, json.dumps(content, indent=2) + "\n")
    return file


def _check(policy: Policy, file: str | Path) -> Path:
    """Check that a policy can be exported to a file."""
    check_kind(policy, Policy, "an export", "load_policy(...)")
    file = Path(file)
    if file.exists():
        raise OutputError(f"{file} exists already: choose another name")
    for space in (policy.model.observation_space, policy.model.action_space):
        if type(space).__name__ != "Box" or len(space.shape) != 1:
            raise InputError(f"only rows of numbers (Box spaces) can be exported, not {space}")
    return file


def _operations_of(policy: Policy) -> list[tuple[str, list[np.ndarray]]]:
    """Return what `Policy.act` computes: names of ONNX operators, each with its constants."""
    found: list[tuple[str, list[np.ndarray]]] = []

    def add(name: str, *values: Any) -> None:
        found.append((name, [np.asarray(value, np.float32) for value in values]))

    normalizer = policy.normalizer
    if normalizer.observations:
        add("Sub", normalizer.mean)
        add("Div", np.sqrt(normalizer.variance + normalizer.epsilon))
        add("Clip", -normalizer.clip, normalizer.clip)
    for layer in _layers_of(policy.model):
        kind = type(layer).__name__
        if kind == "Linear":
            add("Gemm", layer.weight.detach().numpy(), layer.bias.detach().numpy())
        elif kind in _ACTIVATIONS:
            add(_ACTIVATIONS[kind])
        else:
            raise InputError(f"a policy with a {kind} layer cannot be exported")
    low, high = policy.model.action_space.low, policy.model.action_space.high
    if policy.model.squash_output:  # to between -1 and 1
        add("Mul", (high - low) / 2)
        add("Add", (high + low) / 2)
    add("Max", low)
    add("Min", high)
    return found


def _model_of(onnx: Any, policy: Policy) -> Any:
    make, nodes, tensors = onnx.helper, [], []
    before, operations = "observations", _operations_of(policy)
    for i, (name, values) in enumerate(operations):
        names = [f"{i}.{k}" for k in range(len(values))]
        tensors += [onnx.numpy_helper.from_array(*each) for each in zip(values, names, strict=True)]
        after = "actions" if i == len(operations) - 1 else f"value_{i}"
        options = {"transB": 1} if name == "Gemm" else {}
        nodes.append(make.make_node(name, [before, *names], [after], **options))
        before = after
    spaces = {"observations": policy.model.observation_space, "actions": policy.model.action_space}
    ends = [
        make.make_tensor_value_info(name, onnx.TensorProto.FLOAT, ["n", *space.shape])
        for name, space in spaces.items()
    ]
    graph = make.make_graph(nodes, policy.run.environment, ends[:1], ends[1:], tensors)
    opset = make.make_opsetid("", _OPSET)
    model = make.make_model(graph, opset_imports=[opset], producer_name="mjgranular")
    model.ir_version = _FORMAT
    onnx.checker.check_model(model)
    return model


def _layers_of(model: Any) -> list[Any]:
    """Return the layers from scaled observations to actions, with those that squash them."""
    torch = require("torch", extra="onnx", purpose="Exporting a policy")
    if hasattr(model, "actor") and not hasattr(model.actor, "latent_pi"):  # TD3
        return list(model.actor.mu)
    if hasattr(model, "actor"):  # SAC
        layers = [*model.actor.latent_pi, model.actor.mu]
    else:
        layers = [*model.mlp_extractor.policy_net, model.action_net]
    return [*layers, torch.nn.Tanh()] if model.squash_output else layers
