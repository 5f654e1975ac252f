"""The paper's link in other lengths, diameters and densities, and other bodies in its place."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

import mujoco
import numpy as np

from mjgranular._util.checks import check_finite, check_name
from mjgranular.errors import InputError, UnknownNameError
from mjgranular.sand.spec import LAW_TEXT

_FOLDER = Path(__file__).resolve().parent

PAPER_LENGTH = 0.2  # length of the link in link.xml [m]; scenery is scaled with the length
DARK = (0.25, 0.27, 0.31)  # color of legs and heads of robots

LEGGED = {"shell": (0.86, 0.45, 0.16), "leg": DARK}
"""Colors of robots with legs."""


def model_path(name: str) -> Path:
    """Return the path of an MJCF file by name, "link" for example.

    Raises:
        UnknownNameError: no such model; lists the models.
    """
    path = _FOLDER / f"{name}.xml"
    if not path.is_file():
        raise UnknownNameError("model", name, sorted(p.stem for p in _FOLDER.glob("*.xml")))
    return path


@dataclass(frozen=True)
class Link:
    """A slender rod that moves in the plane y = 0; MJCF capsule, hemispheres included in L.

    Attributes:
        length: L, pole to pole [m].
        diameter: d [m].
        density: density of the rod [kg/m^3]; its mass is that of a cylinder, rho pi d^2/4 L.

    Raises:
        InputError: a size that is not positive and finite, or a link that is not slender.
    """

    length: float = 0.2
    diameter: float = 0.01
    density: float = 7700.0

    def __post_init__(self) -> None:
        self._check_sizes("link")

    def _check_sizes(self, what: str) -> None:
        for name, unit in (("length", "m"), ("diameter", "m"), ("density", "kg/m^3")):
            check_finite(f"the {what}'s {name}", getattr(self, name), unit, positive=True)
        if what in ("link", "capsule") and self.diameter >= self.length:
            raise InputError(
                f"the {what} must be longer than it is thick: length {self.length} m, "
                f"diameter {self.diameter} m"
            )

    @property
    def mass(self) -> float:
        """Mass of the slender rod [kg]."""
        return self.density * math.pi * self.diameter**2 / 4 * self.length

    @property
    def inertia(self) -> float:
        """Moment of inertia about a transverse axis through C, m L^2/12 [kg m^2]."""
        return self.mass * self.length**2 / 12

    def spec(self) -> mujoco.MjSpec:
        """Return an editable model: `link.xml` with this link, scenery scaled with its length."""
        spec = mujoco.MjSpec.from_file(str(model_path("link")))
        body = spec.body("link")
        body.mass = self.mass
        body.inertia = [self.inertia, self.inertia, self.mass * self.diameter**2 / 8]
        radius = self.diameter / 2
        spec.geom("link").size[:2] = radius, self.length / 2 - radius
        spec.site("T").pos[2] = -self.length / 2

        scale = self.reach / PAPER_LENGTH
        for name in ("bed", "table"):
            geom = spec.geom(name)
            geom.pos, geom.size = geom.pos * scale, geom.size * scale
        sand = spec.material("sand")
        sand.texrepeat = sand.texrepeat / scale
        for camera in spec.cameras:
            camera.pos = camera.pos * scale
        bed, gap = spec.geom("bed"), radius * 1.1  # the bed begins just behind the link
        back = bed.pos[1] + bed.size[1]
        bed.size[1], bed.pos[1] = (back - gap) / 2, (back + gap) / 2
        spec.visual.map.znear *= min(1.0, scale)
        spec.key("impact").qpos = self.touching(math.pi / 4).tolist()
        return spec

    def model(self, timestep: float) -> mujoco.MjModel:
        """Return the compiled model with a given time step [s]."""
        spec = self.spec()
        spec.option.timestep = timestep
        return spec.compile()

    @property
    def reach(self) -> float:
        """Largest extent [m]."""
        return self.length

    def lowest(self, q: float) -> tuple[float, float]:
        """Return T, the lowest point at an angle: x and z in the body's frame [m]."""
        return 0.0, -self.length / 2

    def touching(self, q: float) -> np.ndarray:
        """Return `qpos` with T on the surface at the origin; q is from the vertical [rad]."""
        x, z = offset(self.lowest(q), q)
        return np.array([-x, -z, q])

    def moving(self, q: float, speed: float, tangential: float, omega: float) -> np.ndarray:
        """Return `qvel` for speeds of T, downward and along x [m/s], and omega = dq/dt [rad/s]."""
        x, z = offset(self.lowest(q), q)
        # A rotation by dq moves T by dq (-z, x) relative to C.
        return np.array([tangential + omega * z, -speed - omega * x, omega])

    def tip(
        self,
        qpos: Sequence[float] | np.ndarray,
        qvel: Sequence[float] | np.ndarray,
        point: tuple[float, float] | None = None,
    ) -> tuple[float, float, float, float]:
        """Return position and velocity of T: (x_T, y_T, v_Tx, v_Ty), y down [m], [m/s].

        The point is T in the body's frame, from `lowest` at release; None for the lower pole.
        """
        x, z, q = qpos
        vx, vz, omega = qvel
        dx, dz = offset((0.0, -self.length / 2) if point is None else point, q)
        return x + dx, -z - dz, vx - omega * dz, -vz - omega * dx


def offset(point: tuple[float, float], q: float) -> tuple[float, float]:
    """Return the vector from C to a point of the body at an angle q about -y, x and z [m]."""
    s, c = math.sin(q), math.cos(q)
    return point[0] * c - point[1] * s, point[0] * s + point[1] * c


def add_part(body: mujoco.MjsBody, name: str, shape: str, **fields: Any) -> mujoco.MjsGeom:
    """Add a geom to a robot, parts of which do not collide with each other."""
    kind = getattr(mujoco.mjtGeom, f"mjGEOM_{shape.upper()}")
    return body.add_geom(name=name, type=kind, contype=0, conaffinity=1, **fields)


def add_servo(
    spec: mujoco.MjSpec, joint: str, stiffness: float, bend: float, torque: float
) -> None:
    """Add a position servo of a joint: gain [N m/rad], largest angle [rad], torque limit [N m]."""
    servo = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    servo.set_to_position(kp=stiffness)
    servo.ctrllimited, servo.ctrlrange = True, [-bend, bend]
    servo.forcelimited, servo.forcerange = True, [-torque, torque]


def robot_scene(
    name: str, timestep: float, colors: dict[str, tuple[float, float, float]]
) -> mujoco.MjSpec:
    """Return an editable model without bodies: lights, a floor at z = 0, materials in colors."""
    spec = mujoco.MjSpec.from_file(str(model_path("link")))
    spec.modelname = name
    spec.comment = f"Made by mjgranular.models: {name}."
    geoms = (spec.geom("bed"), spec.geom("table"))
    for each in (*spec.cameras, *geoms, *spec.texts, spec.body("link"), spec.key("impact")):
        spec.delete(each)
    spec.option.timestep = timestep
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[50, 50, 1])
    for part, color in colors.items():
        spec.add_material(name=part, rgba=[*color, 1], specular=0.3, shininess=0.4)
    return spec


Shape = Literal["link", "sphere", "box", "cylinder", "capsule", "ellipsoid", "plate"]


@dataclass(frozen=True)
class Projectile(Link):
    """A body of one geom that moves in the plane y = 0, with the link's joints and scenery.

    T is the lowest point of the body at release, fixed to the body.

    Attributes:
        length: height along the body's axis [m]; side of a plate; not used for a sphere.
        diameter: size across the axis [m]; thickness of a plate.
        density: [kg/m^3].
        shape: "link" is the paper's slender rod; other shapes have mass and inertia of the solid.

    Raises:
        UnknownNameError: no such shape.
        InputError: a size that is not positive and finite.
    """

    shape: Shape = "link"

    def __post_init__(self) -> None:
        check_name("body", self.shape, get_args(Shape))
        self._check_sizes(self.shape)

    @property
    def halves(self) -> tuple[float, float, float]:
        """Half extents along x, y, z of the body [m]."""
        radius, half = self.diameter / 2, self.length / 2
        if self.shape == "sphere":
            return radius, radius, radius
        if self.shape == "plate":
            return half, half, radius
        return radius, radius, half

    @property
    def solid(self) -> tuple[mujoco.mjtGeom, tuple[float, float, float]]:
        """Type and size of its geom."""
        kinds, (x, y, z) = mujoco.mjtGeom, self.halves
        return {
            "sphere": (kinds.mjGEOM_SPHERE, (x, 0.0, 0.0)),
            "ellipsoid": (kinds.mjGEOM_ELLIPSOID, (x, y, z)),
            "box": (kinds.mjGEOM_BOX, (x, y, z)),
            "plate": (kinds.mjGEOM_BOX, (x, y, z)),
            "cylinder": (kinds.mjGEOM_CYLINDER, (x, z, 0.0)),
        }.get(self.shape, (kinds.mjGEOM_CAPSULE, (x, z - x, 0.0)))

    @property
    def mass(self) -> float:
        return super().mass if self.shape == "link" else float(self._alone.body_mass[1])

    @property
    def inertia(self) -> float:
        return super().inertia if self.shape == "link" else float(self._alone.body_inertia[1, 1])

    @cached_property
    def _alone(self) -> mujoco.MjModel:
        """The solid on its own, of which MuJoCo computes mass and inertia."""
        spec, (kind, size) = mujoco.MjSpec(), self.solid
        spec.worldbody.add_body().add_geom(type=kind, size=size, density=self.density)
        return spec.compile()

    @property
    def reach(self) -> float:
        return max(self.halves) * 2

    def spec(self) -> mujoco.MjSpec:
        spec = super().spec()
        if self.shape == "link":
            return spec
        spec.delete(spec.text(LAW_TEXT))
        geom, body, alone = spec.geom("link"), spec.body("link"), self._alone
        geom.type, geom.size = self.solid
        body.mass, body.inertia = alone.body_mass[1], alone.body_inertia[1]
        spec.site("T").pos = [0, 0, -self.halves[2]]
        return spec

    def lowest(self, q: float) -> tuple[float, float]:
        x, _, z = self.halves
        # Downward direction in the frame of the body, rotated by q about -y.
        dx, dz = -math.sin(q), -math.cos(q)
        if self.shape == "link":
            return 0.0, -z
        if self.shape in ("sphere", "ellipsoid"):
            size = math.hypot(x * dx, z * dz)
            return x * x * dx / size, z * z * dz / size
        if self.shape in ("box", "plate", "cylinder"):
            return (math.copysign(x, dx) if abs(dx) > 1e-9 else 0.0), math.copysign(z, dz)
        return x * dx, math.copysign(z - x, dz) + x * dz
