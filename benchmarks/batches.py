"""Many simulations of one model on several threads: `mujoco.batch.Batch`."""

from __future__ import annotations

import importlib
import os
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from measure import Case, Group

import mjgranular
from mjgranular.models import Link

_TIMESTEP = 1e-5
_STEPS = 50
_SIMULATIONS = (1, 16, 256, 4096)
_SANDS = (
    ("link, explicit", "link", "explicit"),
    ("20 elements, explicit", "link_distributed", "explicit"),
    ("20 elements, implicit", "link_distributed", "implicit"),
)


def _batched(name: str, model: mujoco.MjModel, count: int, threads: int) -> Case:
    batch: Any = importlib.import_module("mujoco.batch").Batch(model, count, threads)
    return Case(
        name,
        lambda: batch.reset(keyframe=0),
        lambda: batch.step(nstep=_STEPS),
        count * _STEPS,
        {"simulations": count, "threads": threads},
    )


def _cases(count: int) -> Sequence[Case]:
    spec = Link().spec()
    spec.option.timestep = _TIMESTEP
    models = {"without sand": spec.compile()}
    for name, law, scheme in _SANDS:
        spec = Link().spec()
        spec.option.timestep = _TIMESTEP
        mjgranular.add_sand(spec, law=law, scheme=scheme)
        models[name] = spec.compile()
    cores = os.cpu_count() or 1
    threads = sorted(int(n) for n in np.unique([1, 2, cores]) if n <= max(cores, 2))
    return [
        _batched(f"{name}, {n} thread{'s' if n > 1 else ''}", model, count, n)
        for n in threads
        for name, model in models.items()
    ]


def _groups() -> tuple[Group, ...]:
    try:
        importlib.import_module("mujoco.batch")
    except ImportError:
        return ()
    return tuple(
        Group(
            f"Batch of {count}",
            "The link at 10 m/s, `Batch.step(nstep=50)`: the lumped law, and the distributed one "
            "with 20 elements; costs of one step of one simulation.",
            lambda count=count: _cases(count),
        )
        for count in _SIMULATIONS
    )


GROUPS = _groups()
