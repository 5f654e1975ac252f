"""Which sands act on one simulation: one for a body, unless all of them say that they share it."""

from __future__ import annotations

import weakref
from dataclasses import dataclass

import mujoco
import numpy as np

from mjgranular.errors import InputError
from mjgranular.kernel.compiled import entry
from mjgranular.sand.binding import Binding
from mjgranular.sand.guard import withdraw
from mjgranular.shape.select import body_name


@dataclass(frozen=True)
class _Member:
    """What one Sand acts on."""

    bodies: frozenset[int]
    shared: bool


def refuse_sand_of_its_own(model: mujoco.MjModel, elements: np.ndarray) -> None:
    """Refuses bodies on which a plugin instance of the model acts already, inside `mj_step`.

    Raises:
        InputError: says which.
    """
    if model.nplugin == 0:
        return
    from mjgranular.engine.instances import bodies_of, sands_in  # it stands on this package

    ours = set(elements["body"].tolist())
    for name in sands_in(model):
        common = ours & bodies_of(model, name)
        if common:
            raise InputError(
                f"the model has sand of its own, the plugin instance {name!r}, which acts on body "
                f"{body_name(model, min(common))} inside mj_step: step it with mj_step and without "
                "Sand, or say shared=True if both are to act"
            )


class Company:
    """The Sands that act on one `MjData`, and their shares in its `xfrc_applied`."""

    def __init__(self) -> None:
        self._members: weakref.WeakKeyDictionary[object, _Member] = weakref.WeakKeyDictionary()
        self._shares: list[Binding] = []  # of shared Sands, in the order they were added

    def join(self, sand: object, model: mujoco.MjModel, binding: Binding, *, shared: bool) -> None:
        """Lets a Sand in.

        Raises:
            InputError: another acts on one of its bodies, and not both are shared.
        """
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

    def leave(self, sand: object, binding: Binding) -> None:
        """Lets a Sand go, and its share too."""
        if self._members.pop(sand).shared:
            self._clear()
        else:
            _withdraw(binding)

    def begin(self, binding: Binding) -> None:
        """Makes room for the share of a shared Sand.

        The first that comes for a second time begins a new step: the shares of the last one go.
        """
        if any(share is binding for share in self._shares):
            self._clear()
        self._shares.append(binding)

    def _clear(self) -> None:
        """Takes all shares back, the latest first: each finds the row as it was left."""
        while self._shares:
            _withdraw(self._shares.pop())


def _withdraw(binding: Binding) -> None:
    entry(withdraw, "int64(int64)")(binding.table.ctypes.data)


_companies: weakref.WeakKeyDictionary[mujoco.MjData, Company] = weakref.WeakKeyDictionary()


def company_of(data: mujoco.MjData) -> Company:
    """Those that act on `data`; nobody at first."""
    return _companies.setdefault(data, Company())
