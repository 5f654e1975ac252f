"""Reports of the sand's action on a model at one instant, for people, logs and plots."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import mujoco
import numpy as np

from mjgranular.errors import UnknownNameError
from mjgranular.law.validity import Finding, Measure, Standing, found_at
from mjgranular.sand.binding import Binding
from mjgranular.sand.prepare import PreparedSand
from mjgranular.scheme.workspace import Solver as Solver
from mjgranular.shape.sizes import name_of

_SHOWN = 3  # bodies in a report's `repr`
# A body faster than this [m/s] turns in the sand where it turns by more than this [rad] while it
# moves by the width of its elements. Chosen, not measured.
_SLOW, _TURN = 0.01, 0.2

_VECTORS = ("point", "velocity", "force")
_NUMBERS = ("depth", "immersed_length", "power", "froude", "width")
ELEMENT_DTYPE = np.dtype(
    [
        *((name, np.int64) for name in ("geom_id", "body_id")),
        *((name, np.float64) for name in _NUMBERS),
        *((name, np.float64, (3,)) for name in _VECTORS),
    ]
)
"""Fields of `Report.elements`. Vectors are in the world frame.

- `geom_id`, `body_id`: ids of the geom that the element was made from, and of its body.
- `depth`: depth of the element below the surface, of a rod's deeper end [m]; negative above it.
- `immersed_length`: length of a rod in the sand [m]; 0 for other elements.
- `point`: E, where the force acts [m]; the element's middle above the sand.
- `velocity`: velocity of that point at the beginning of the step [m/s]; zero above the sand.
- `force`: force of the sand on the element [N].
- `power`: power of that force on the body [W]. Under the implicit scheme it is that at the end of
  the step, where the force is: never positive in sum over a body, and up to a hundredth of the
  greatest for one element.
- `froude`: Froude number |v_E| / sqrt(g w) with this width w; 0 without gravity.
- `width`: diameter of a rod, width of the widest face on a facet's geom [m].
"""


@dataclass(frozen=True)
class BodyReport:
    """The sand on one body. Vectors are in the world frame.

    Attributes:
        body: name of the body, or its number.
        force: force of the sand on the body [N], shape (3,).
        moment: about the body's center of mass [N m], shape (3,).
        point: E, where the force of the body's deepest element acts [m], shape (3,).
        depth: largest depth of its elements [m], negative above the sand.
        immersed_length: sum over its rods [m].
        power: sum over its elements [W].
        froude: largest Froude number of its elements in the sand.
        validity: measures of the body against the law's limits.
        found: the measured error for drops, pushes and drags as fast as this; None above the sand,
            where nothing as fast was compared, and where the body turns in the sand, as wheels and
            legs do (docs/validity.md has their errors).
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
    found: Finding | None = None

    @property
    def error(self) -> float | None:
        """The measured relative error for such motion; None if unknown."""
        return None if self.found is None else self.found.error

    @property
    def valid(self) -> bool:
        """True if the limits of the law hold for this body now, or if it has none."""
        return all(standing.holds for standing in self.validity)


@dataclass(frozen=True)
class Names:
    """Names of a model's geoms and bodies by their ids; numbers for those without one."""

    geoms: dict[int, str]
    bodies: dict[int, str]

    @classmethod
    def of(cls, model: mujoco.MjModel, elements: np.ndarray) -> Self:
        """Return the names of the geoms and bodies of some elements."""
        geoms, bodies = np.unique(elements["geom"]), np.unique(elements["body"])
        return cls(
            {int(g): name_of(model, "geom", int(g)) or str(g) for g in geoms},
            {int(b): name_of(model, "body", int(b)) or str(b) for b in bodies},
        )


@dataclass(frozen=True)
class Report:
    """The sand on a model at one instant.

    Attributes:
        time: time of the simulation [s].
        bodies: one report per body, in the order of the model.
        elements: a record for each element, shape (n,), with the fields of `ELEMENT_DTYPE`:
            `elements.depth` has all depths, `elements[0].depth` is one.
        names: names of geoms and bodies, by their ids.
        medium: name of the medium.
        law: name of the law.
        solver: counters of the implicit scheme; None with the explicit one, or before a first step.
    """

    time: float
    bodies: tuple[BodyReport, ...]
    elements: np.recarray
    names: Names
    medium: str
    law: str
    solver: Solver | None = None

    def __repr__(self) -> str:
        """Return each body's depth and force."""
        bodies = [
            f"{body.body} {1e3 * body.depth:.4g} mm deep, {np.linalg.norm(body.force):.4g} N"
            for body in self.bodies[:_SHOWN]
        ]
        if len(self.bodies) > _SHOWN:
            bodies.append(f"{len(self.bodies) - _SHOWN} more")
        return f"Report(t={self.time:.6g} s, {self.medium}, {self.law} law: {'; '.join(bodies)})"

    def __iter__(self) -> Iterator[str]:
        return (report.body for report in self.bodies)

    def __getitem__(self, body: str | int) -> BodyReport:
        """Return the report of a body, by its name or number; a string is a name first.

        Raises:
            UnknownNameError: the sand does not act on this body; lists the bodies that it acts on.
        """
        names = self.names.bodies
        found = dict(zip(map(str, names), self.bodies, strict=True))
        if isinstance(body, str):
            found |= {name: found[str(i)] for i, name in names.items() if name != str(i)}
        if str(body) in found:
            return found[str(body)]
        raise UnknownNameError("body with sand on it", str(body), [r.body for r in self.bodies])


@np.errstate(over="ignore", invalid="ignore")  # overflow is reported as infinite
def describe(
    data: mujoco.MjData,
    *,
    sand: PreparedSand,
    names: Names,
    binding: Binding,
    gravity: float,
    slope: float,
    solver: Solver | None,
) -> Report:
    """Make a report from the contacts that a kernel has just filled in.

    Gravity is a magnitude [m/s^2], and the slope of the surface is in radians.
    """
    table = _element_records(data, sand.elements, binding.contacts, gravity)
    limits, grain = sand.law.validity, sand.medium.grain and sand.medium.grain.value
    findings = sand.law.findings
    bodies, first = [], 0
    for row in binding.bodies:
        mine, first = np.arange(first, row["end"]), row["end"]
        deepest = mine[np.argmax(table.depth[mine])]
        immersed = mine[table.depth[mine] > 0]
        measures = _measures(table, immersed, gravity=gravity, slope=slope, grain=grain)
        froude = float(measures["froude"] or 0.0)
        found = None
        if len(immersed) and not _turns(table, immersed):
            found = found_at(findings, froude, grain and float(table.width[immersed].min()) / grain)
        bodies.append(
            BodyReport(
                body=names.bodies[int(row["body"])],
                force=row["wrench"][:3].copy(),
                moment=row["wrench"][3:].copy(),
                point=table.point[deepest].copy(),
                depth=float(table.depth[deepest]),
                immersed_length=float(table.immersed_length[mine].sum()),
                power=float(table.power[mine].sum()),
                froude=froude,
                validity=tuple(Standing(limit, measures[limit.measure]) for limit in limits),
                found=found,
            )
        )
    return Report(
        time=float(data.time),
        bodies=tuple(bodies),
        elements=table,
        names=names,
        medium=sand.medium.name,
        law=sand.law.name,
        solver=solver,
    )


def _element_records(
    data: mujoco.MjData, elements: np.ndarray, contacts: np.ndarray, gravity: float
) -> np.recarray:
    """Copy the contacts; above the sand kernels write only the depth."""
    table = np.recarray(len(elements), ELEMENT_DTYPE)
    for name, origin in (("geom_id", "geom"), ("body_id", "body"), ("width", "width")):
        table[name] = elements[origin]
    for name in ("depth", "power", *_VECTORS):
        table[name] = contacts[name]
    table["immersed_length"] = contacts["length"]
    dry = table["depth"] <= 0
    for name in ("velocity", "force", "immersed_length", "power"):
        table[name][dry] = 0.0
    local = elements["point" if "point" in (elements.dtype.names or ()) else "center"][dry]
    body = elements["body"][dry]
    turned = np.einsum("nij,nj->ni", data.xmat[body].reshape(-1, 3, 3), local)
    table["point"][dry] = data.xpos[body] + turned
    speed = np.sqrt((table["velocity"] ** 2).sum(axis=1))
    scale = np.sqrt(gravity * elements["width"])
    table["froude"] = np.divide(speed, scale, out=np.zeros_like(speed), where=scale > 0)
    return table


def _turns(table: np.recarray, immersed: np.ndarray) -> bool:
    """Return True if a body turns in the sand, from the spread of its elements' velocities."""
    point, velocity = table.point[immersed], table.velocity[immersed]
    speed, across = _rms(velocity), _rms(point - point.mean(axis=0))
    if speed < _SLOW or across == 0.0:
        return False
    rate = _rms(velocity - velocity.mean(axis=0)) / across  # [rad/s]
    return rate * float(table.width[immersed].max()) > _TURN * speed


def _rms(vectors: np.ndarray) -> float:
    return math.sqrt(float((vectors**2).sum(axis=1).mean()))


def _measures(
    table: np.recarray, immersed: np.ndarray, *, gravity: float, slope: float, grain: float | None
) -> dict[Measure, float | None]:
    """Return the measures of validity of one body: the largest over its elements in the sand."""
    measures: dict[Measure, float | None] = {
        "slope": slope,
        "froude": 0.0,
        "depth_over_width": 0.0,
        "inertial_number": None if grain is None or gravity == 0 else 0.0,
    }
    if len(immersed):
        width, depth = table.width[immersed], table.depth[immersed]
        measures["froude"] = float(table.froude[immersed].max())
        measures["depth_over_width"] = float((depth / width).max())
        if grain is not None and gravity > 0:
            # Shear rate v / w, pressure rho g z: the density cancels.
            speed = np.sqrt((table.velocity[immersed] ** 2).sum(axis=1))
            # Less than a grain deep there is hardly any flow.
            number = speed / width * grain / np.sqrt(gravity * np.maximum(depth, grain))
            measures["inertial_number"] = float(number.max())
    return measures
