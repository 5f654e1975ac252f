"""The paper's link in other lengths, diameters and densities."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from mjgranular.errors import InputError, UnknownNameError

_FOLDER = Path(__file__).resolve().parent
_PAPER_LENGTH = 0.2  # of the link in link.xml [m]; scenery is scaled with the length


def model_path(name: str) -> Path:
    """The MJCF file of that name, "link" for example.

    Raises:
        UnknownNameError: no such model; lists those there are.
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
        density: of the rod [kg/m^3]; its mass is that of a cylinder, rho pi d^2/4 L.

    Raises:
        InputError: a size that is not positive and finite, or a link that is not slender.
    """

    length: float = 0.2
    diameter: float = 0.01
    density: float = 7700.0

    def __post_init__(self) -> None:
        for name, unit in (("length", "m"), ("diameter", "m"), ("density", "kg/m^3")):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InputError(
                    f"the link's {name} must be positive and finite, not {value} {unit}"
                )
        if self.diameter >= self.length:
            raise InputError(
                f"the link must be longer than it is thick: length {self.length} m, "
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
        """An editable model: `link.xml` with this link in it, scenery scaled with its length."""
        spec = mujoco.MjSpec.from_file(str(model_path("link")))
        body = spec.body("link")
        body.mass = self.mass
        body.inertia = [self.inertia, self.inertia, self.mass * self.diameter**2 / 8]
        radius = self.diameter / 2
        spec.geom("link").size[:2] = radius, self.length / 2 - radius
        spec.site("T").pos[2] = -self.length / 2

        scale = self.length / _PAPER_LENGTH
        for name in ("bed", "table"):
            geom = spec.geom(name)
            geom.pos = geom.pos * scale
            geom.size = geom.size * scale
        bed, gap = spec.geom("bed"), radius * 1.1  # the bed begins just behind the link
        back = bed.pos[1] + bed.size[1]
        bed.size[1], bed.pos[1] = (back - gap) / 2, (back + gap) / 2
        sand = spec.material("sand")
        sand.texrepeat = sand.texrepeat / scale
        for camera in spec.cameras:
            camera.pos = camera.pos * scale
        spec.visual.map.znear *= min(1.0, scale)
        key = spec.key("impact")
        key.qpos = self.touching(math.pi / 4).tolist()
        return spec

    def model(self, timestep: float) -> mujoco.MjModel:
        """The compiled model with that time step [s]."""
        spec = self.spec()
        spec.option.timestep = timestep
        return spec.compile()

    def touching(self, q: float) -> np.ndarray:
        """`qpos` with T on the surface at the origin, shape (3,).

        Args:
            q: angle from the vertical [rad].
        """
        half = self.length / 2
        return np.array([-half * math.sin(q), half * math.cos(q), q])

    def moving(self, q: float, speed: float, tangential: float, omega: float) -> np.ndarray:
        """`qvel` for given velocities of T, shape (3,).

        Args:
            q: angle from the vertical [rad].
            speed: v_Ty, of T, down [m/s].
            tangential: v_Tx, of T, along x [m/s].
            omega: dq/dt [rad/s].
        """
        half = self.length / 2
        # v_T = v_C + omega L/2 (cos q, -sin q), y down.
        vx = tangential - omega * half * math.cos(q)
        vy = speed + omega * half * math.sin(q)
        return np.array([vx, -vy, omega])

    def tip(self, qpos: np.ndarray, qvel: np.ndarray) -> tuple[float, float, float, float]:
        """Where T is and how it moves: (x_T, y_T, v_Tx, v_Ty), y down [m], [m/s]."""
        x, z, q = qpos.tolist()
        vx, vz, omega = qvel.tolist()
        half = self.length / 2
        s, c = half * math.sin(q), half * math.cos(q)
        return x + s, c - z, vx + omega * c, -vz - omega * s
