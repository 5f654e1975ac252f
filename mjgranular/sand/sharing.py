"""Registry of the sands of one simulation: one per body, unless all of them are shared."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import mujoco
import numpy as np

from mjgranular.errors import InputError
from mjgranular.kernel.compiled import entry
from mjgranular.sand.binding import Binding
from mjgranular.sand.guard import withdraw
from mjgranular.shape.select import body_name

SandsOfModel = Callable[[mujoco.MjModel], Iterable[tuple[str, set[int]]]]
"""Return the sands that are a part of a model: name, and ids of the bodies that it acts on."""

_sands_of_model: list[SandsOfModel] = []


def ask_about_models(sands_of_model: SandsOfModel) -> None:
    """Register a function by which `Sand` finds bodies on which a model's own sand acts."""
    _sands_of_model.append(sands_of_model)


def find_sand_of_the_model(model: mujoco.MjModel, elements: np.ndarray) -> str:
    """Return which of the model's own sands acts on one of these bodies, in words; "" for none."""
    ours = set(elements["body"].tolist())
    for sands_of_model in _sands_of_model:
        for name, bodies in sands_of_model(model):
            common = ours & bodies
            if common:
                return (
                    f"the plugin instance {name!r}, which acts on body "
                    f"{body_name(model, min(common))}"
                )
    return ""


@dataclass(frozen=True)
class _Member:
    """Bodies of one Sand."""

    bodies: frozenset[int]
    shared: bool


class SandRegistry:
    """The Sands that act on one `MjData`, and their shares in its `xfrc_applied`."""

    def __init__(self) -> None:
        self._members: weakref.WeakKeyDictionary[object, _Member] = weakref.WeakKeyDictionary()
        self._shares: list[Binding] = []  # of shared Sands, in the order they were added

    def add(self, sand: object, model: mujoco.MjModel, binding: Binding, *, shared: bool) -> None:
        """Register a Sand; raise if another acts on one of its bodies, and not both are shared."""
        bodies = frozenset(binding.bodies["body"].tolist())
        for other in list(self._members.values()):
            common = bodies & other.bodies
            if common and not (shared and other.shared):
                raise InputError(
                    f"another Sand acts on body {body_name(model, min(common))} of this MjData: "
                    "make an MjData for each, make both with shared=True if both are to act (two "
                    "beds, say), or have the other one release(data) first"
                )
        self._members[sand] = _Member(bodies, shared)

    def remove(self, sand: object, binding: Binding) -> None:
        """Remove a Sand, and its share too."""
        if self._members.pop(sand).shared:
            self._withdraw_all()
        else:
            _withdraw(binding)

    def begin(self, binding: Binding) -> None:
        """Prepare for the share of a shared Sand.

        The first that comes for a second time begins a new step: the shares of the last step are
        removed.
        """
        if any(share is binding for share in self._shares):
            self._withdraw_all()
        self._shares.append(binding)

    def down_to(self, binding: Binding) -> list[Binding]:
        """Return the shares that have come since a Sand's own, the latest first, and its own.

        A Sand acts in addition to those that came before it.
        """
        for number, share in enumerate(self._shares):
            if share is binding:
                return self._shares[number:][::-1]
        return [binding]

    def _withdraw_all(self) -> None:
        """Take all shares back, the latest first: each finds the row as it left it."""
        while self._shares:
            _withdraw(self._shares.pop())


def _withdraw(binding: Binding) -> None:
    entry(withdraw, "int64(int64)")(binding.table.ctypes.data)


_registries: weakref.WeakKeyDictionary[mujoco.MjData, SandRegistry] = weakref.WeakKeyDictionary()


def registry_of(data: mujoco.MjData) -> SandRegistry:
    """Return the registry of the Sands that act on `data`; empty at first."""
    return _registries.setdefault(data, SandRegistry())
