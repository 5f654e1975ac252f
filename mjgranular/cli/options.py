"""Options that commands share."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import tyro

from mjgranular.experiment import Impact


@dataclass(frozen=True)
class LinkOptions:
    """The link, the sand and the simulation."""

    tangential_speed: Annotated[float, tyro.conf.arg(metavar="M/S")] = 0.0
    """Velocity of T along the surface at release, towards the side the link leans to [m/s]."""
    angular_velocity: Annotated[float, tyro.conf.arg(metavar="RAD/S")] = 0.0
    """Rate of change of the angle at release [rad/s]."""
    height: Annotated[float, tyro.conf.arg(metavar="M")] = 0.0
    """Height of the end T above the surface at release [m]."""
    length: Annotated[float, tyro.conf.arg(metavar="M")] = 0.2
    """Length of the link [m]."""
    diameter: Annotated[float, tyro.conf.arg(metavar="M")] = 0.01
    """Diameter of the link [m]."""
    density: Annotated[float, tyro.conf.arg(metavar="KG/M^3")] = 7700.0
    """Density of the link [kg/m^3]."""
    medium: Annotated[str, tyro.conf.arg(metavar="NAME")] = "play_sand"
    """The sand; `mjgranular media` lists what there is."""
    law: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None
    """The force law; `mjgranular laws` lists what there is. Default: the medium's own."""
    scheme: Annotated[str, tyro.conf.arg(metavar="NAME")] = "explicit"
    """How forces become a step."""
    timestep: Annotated[float, tyro.conf.arg(metavar="S")] = 1e-5
    """Time step of the simulation [s]."""
    duration: Annotated[float, tyro.conf.arg(metavar="S")] = 2.0
    """Simulated time after which the run ends at the latest [s]."""

    def impact(
        self, *, speed: float, angle_deg: float, until: str = "stop", body: str = "link"
    ) -> Impact:
        """The drop with these options."""
        return Impact(
            speed=speed,
            angle=math.radians(angle_deg),
            tangential_speed=self.tangential_speed,
            angular_velocity=self.angular_velocity,
            height=self.height,
            length=self.length,
            diameter=self.diameter,
            density=self.density,
            medium=self.medium,
            law=self.law,
            scheme=self.scheme,
            timestep=self.timestep,
            until=until,  # pyright: ignore[reportArgumentType]
            duration=self.duration,
            body=body,  # pyright: ignore[reportArgumentType]
        )
