"""What the sand does to a model at one instant, for people, logs and plots."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mjgranular.errors import UnknownNameError


@dataclass(frozen=True)
class ElementReport:
    """The sand on one element. Vectors are in the world frame.

    Attributes:
        geom: name of the geom that the element was made from, or its number.
        body: name of the body, or its number.
        depth: of the element's deepest point below the surface [m], negative above it.
        immersed_length: length of the element's axis in the sand [m].
        point: E, where the force acts [m], shape (3,).
        velocity: of that point [m/s], shape (3,).
        force: of the sand on the element [N], shape (3,).
        power: of that force on the body [W]; never positive for a dissipative law.
        froude: Froude number |v_E| / sqrt(g d) with the rod's diameter d; 0 without gravity.
    """

    geom: str
    body: str
    depth: float
    immersed_length: float
    point: np.ndarray
    velocity: np.ndarray
    force: np.ndarray
    power: float
    froude: float


@dataclass(frozen=True)
class BodyReport:
    """The sand on one body. Vectors are in the world frame.

    Attributes:
        body: name of the body, or its number.
        force: of the sand on the body [N], shape (3,).
        moment: about the body's centre of mass [N m], shape (3,).
        point: E, where the force of the body's deepest element acts [m], shape (3,).
        depth: greatest depth of its elements [m], negative above the sand.
        immersed_length: sum over its elements [m].
        power: sum over its elements [W].
        froude: greatest of its elements.
    """

    body: str
    force: np.ndarray
    moment: np.ndarray
    point: np.ndarray
    depth: float
    immersed_length: float
    power: float
    froude: float


@dataclass(frozen=True)
class Report:
    """The sand on a model at one instant.

    Attributes:
        time: of the simulation [s].
        bodies: one report a body, in the order of the model.
        elements: one report an element.
    """

    time: float
    bodies: tuple[BodyReport, ...]
    elements: tuple[ElementReport, ...]

    def __getitem__(self, body: str) -> BodyReport:
        """The report of the body of that name.

        Raises:
            UnknownNameError: no such body in the sand's care; lists those that are.
        """
        for report in self.bodies:
            if report.body == body:
                return report
        raise UnknownNameError("body with sand on it", body, [r.body for r in self.bodies])

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers and lists, as for JSON."""
        return _plain(asdict(self))


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return value.tolist() if isinstance(value, np.ndarray) else value
