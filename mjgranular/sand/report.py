"""What the sand does to a model at one instant, for people, logs and plots."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import mujoco
import numpy as np

from mjgranular.errors import UnknownNameError
from mjgranular.law.validity import Limit, Measure, Standing
from mjgranular.sand.binding import Binding


@dataclass(frozen=True)
class ElementReport:
    """The sand on one element. Vectors are in the world frame.

    Attributes:
        geom: name of the geom that the element was made from, or its number.
        body: name of the body, or its number.
        depth: of the element's deepest point below the surface [m], negative above it.
        immersed_length: length of the element's axis in the sand [m].
        point: E, where the force acts [m], shape (3,); the element's middle above the sand.
        velocity: of that point [m/s], shape (3,); zero above the sand.
        force: of the sand on the element [N], shape (3,).
        power: of that force on the body [W]; never positive for a dissipative law.
        froude: Froude number |v_E| / sqrt(g w) with the geom's width w, a rod's diameter; 0
            without gravity.
        width: of the geom [m].
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
    width: float


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
        froude: greatest of its elements in the sand.
        validity: how the body stands against the law's limits.
    """

    body: str
    force: np.ndarray
    moment: np.ndarray
    point: np.ndarray
    depth: float
    immersed_length: float
    power: float
    froude: float
    validity: tuple[Standing, ...] = ()

    @property
    def valid(self) -> bool:
        """Whether the law holds for this body now."""
        return all(standing.holds for standing in self.validity)


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


def element_names(model: mujoco.MjModel, elements: np.ndarray) -> list[tuple[str, str]]:
    """For each element, the names of its geom and body; numbers where they have none."""
    return [
        (
            model.geom(element["geom"]).name or str(element["geom"]),
            model.body(element["body"]).name or str(element["body"]),
        )
        for element in elements
    ]


def describe(
    data: mujoco.MjData,
    *,
    elements: np.ndarray,
    names: list[tuple[str, str]],
    binding: Binding,
    gravity: float,
    limits: tuple[Limit, ...] = (),
    slope: float = 0.0,
    grain: float | None = None,
) -> Report:
    """Makes a report of what a kernel has just filled in.

    Args:
        data: the simulation.
        elements: the law's elements.
        names: of each element's geom and body.
        binding: with wrenches and contacts.
        gravity: its size [m/s^2].
        limits: of the law.
        slope: of the surface [rad].
        grain: diameter of a grain [m], None if it is not known.
    """
    reports = []
    for element, (geom, body), contact in zip(elements, names, binding.contacts, strict=True):
        if contact["depth"] > 0:
            point = contact["point"].copy()
            velocity, force = contact["velocity"].copy(), contact["force"].copy()
        else:  # kernels leave the rest of a dry element's contact as it was
            axes = data.xmat[element["body"]].reshape(3, 3)
            local = element["point" if "point" in elements.dtype.names else "center"]
            point = data.xpos[element["body"]] + axes @ local
            velocity, force = np.zeros(3), np.zeros(3)
        scale = math.sqrt(gravity * element["width"])
        reports.append(
            ElementReport(
                geom=geom,
                body=body,
                depth=float(contact["depth"]),
                immersed_length=float(contact["length"]) if contact["depth"] > 0 else 0.0,
                point=point,
                velocity=velocity,
                force=force,
                power=float(force @ velocity),
                froude=math.sqrt(velocity @ velocity) / scale if scale > 0 else 0.0,
                width=float(element["width"]),
            )
        )
    members: list[list[ElementReport]] = [[] for _ in binding.bodies]
    for element, report in zip(elements, reports, strict=True):
        members[element["slot"]].append(report)
    bodies = []
    for row, mine in zip(binding.bodies, members, strict=True):
        deepest = max(mine, key=lambda report: report.depth)
        bodies.append(
            BodyReport(
                body=deepest.body,
                force=row["wrench"][:3].copy(),
                moment=row["wrench"][3:].copy(),
                point=deepest.point,
                depth=deepest.depth,
                immersed_length=sum(report.immersed_length for report in mine),
                power=sum(report.power for report in mine),
                froude=max(report.froude for report in mine),
                validity=_standings(mine, limits, gravity=gravity, slope=slope, grain=grain),
            )
        )
    return Report(time=float(data.time), bodies=tuple(bodies), elements=tuple(reports))


def _standings(
    elements: list[ElementReport],
    limits: tuple[Limit, ...],
    *,
    gravity: float,
    slope: float,
    grain: float | None,
) -> tuple[Standing, ...]:
    """How a body stands against each limit; measures are the greatest over elements in the sand."""
    values: dict[Measure, float | None] = {
        "slope": slope,
        "froude": 0.0,
        "depth_over_width": 0.0,
        "inertial_number": None if grain is None else 0.0,
    }
    for element in elements:
        if element.depth <= 0 or element.width <= 0:
            continue
        speed = math.sqrt(element.velocity @ element.velocity)
        found: dict[Measure, float | None] = {
            "froude": element.froude,
            "depth_over_width": element.depth / element.width,
        }
        if grain is not None and gravity > 0:
            # Shear rate v / w, pressure rho g z: the density cancels.
            found["inertial_number"] = (
                speed / element.width * grain / math.sqrt(gravity * element.depth)
            )
        for measure, value in found.items():
            values[measure] = max(values[measure] or 0.0, value or 0.0)
    return tuple(Standing(limit, values[limit.measure]) for limit in limits)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return value.tolist() if isinstance(value, np.ndarray) else value
