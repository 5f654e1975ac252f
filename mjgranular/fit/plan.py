"""Simulated runs for planning, as a law predicts them."""

from __future__ import annotations

import numpy as np

from mjgranular.fit.body import Body
from mjgranular.fit.constants import Material
from mjgranular.fit.curve import find_arrest
from mjgranular.fit.drop import DropTrial
from mjgranular.fit.push import DragTrial, PushTrial
from mjgranular.fit.run import Run

_ROWS = 60  # rows of a record


def planned_drop(
    body: Body, speed: float, angle: float, duration: float, material: Material
) -> DropTrial:
    """Return a drop, followed for a time [s] or until it rests.

    Raises:
        GranularError: the law does not support the body, or it does not reach the sand.
    """
    time = np.linspace(0.0, duration, 4)
    free = speed * time + 0.1 * 9.81 * time**2
    trial = DropTrial(_run("drop", body, {"time": time, "depth": free}, speed, angle))
    fall = trial.simulate(material)
    arrest = find_arrest(fall.time, fall.depth)
    end = min(1.3 * (arrest.time or duration), fall.time[-1])
    time = np.linspace(0.0, end, _ROWS)
    record = {"time": time, "depth": np.interp(time, fall.time, fall.depth)}
    return DropTrial(_run("drop", body, record, speed, angle))


def planned_push(body: Body, depth: float, material: Material) -> PushTrial:
    """Return a slow push to a depth [m]."""
    places = np.linspace(depth / _ROWS, depth, _ROWS)
    record = {"depth": places, "force": np.ones(_ROWS)}
    force = PushTrial(_run("intrude", body, record)).simulate(material)
    return PushTrial(_run("intrude", body, {**record, "force": force}))


def planned_drag(body: Body, depth: float, material: Material) -> DragTrial:
    """Return a drag at a depth [m], at speeds up to 1 m/s."""
    speed = np.linspace(0.01, 1.0, 15)
    record = {"speed": speed, "force": np.ones(len(speed))}
    force = DragTrial(_run("drag", body, record, depth=depth)).simulate(material)
    return DragTrial(_run("drag", body, {**record, "force": force}, depth=depth))


def _run(
    kind: str,
    body: Body,
    data: dict[str, np.ndarray],
    speed: float | None = None,
    angle: float = 0.0,
    depth: float | None = None,
) -> Run:
    return Run("planned", kind, data, body=body, speed=speed, angle=angle, depth=depth)  # pyright: ignore
