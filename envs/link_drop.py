"""The paper's impact as a one-step problem."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import mujoco
import numpy as np
from gymnasium.spaces import Box

from mjgranular import InputError, Law, Medium
from mjgranular.envs.ground import Dunes
from mjgranular.envs.task import Start, State, Task
from mjgranular.models import Link

STEEPEST = math.radians(75)  # angle of the link from the vertical for an action of 1
FASTEST = 40.0  # spin for an action of 1 [rad/s]


@dataclass(frozen=True, kw_only=True)
class LinkDrop(Task):
    """Throw a link so that it comes to rest at a given depth.

    ## Description
    The planar steel link of Lee and Marghitu, 0.2 m long and 10 mm thick, meets play sand end first
    at a speed that is given; the angle and the spin at release are to be chosen so that its deepest
    point comes to rest at the depth that is asked for. One step is one drop: the sand's static
    resistance, its drag and its turning of the link all count. The law is the paper's, distributed
    along the axis so that it resists turning too.

    ## Action Space
    `Box(-1, 1, (2,), float32)`: the angle from the vertical, 0 to 75 degrees for -1 to 1; the spin,
    in units of 40 rad/s, positive with the lower end swinging to the side that the link leans to.

    ## Observation Space
    `Box(-inf, inf, (2,), float64)`: the depth asked for, in lengths of the link; the speed [m/s].

    ## Rewards
    - `reward_depth`: minus the difference of depths, reached and asked for, in lengths of the link.

    ## Starting State
    The lower end touches the surface. The depth that is asked for is drawn evenly from
    `target_range`, the speed from `speed_range`.

    ## Episode End
    Terminated after one step, 0.25 s after touch-down.

    ## Arguments
    `target_range=(0.06, 0.2)` link lengths, `speed_range=(1, 5)` m/s, `frame_skip=500` substeps of
    0.5 ms, and those of `Task`.
    """

    title: ClassVar[str] = "angle and spin of a drop for a given depth, in one step"
    episode: ClassVar[int] = 1
    tile: ClassVar[float] = 0.2
    dunes: ClassVar[Dunes] = Dunes(wavelength=4.0, extent=10.0)
    link: ClassVar[Link] = Link()
    camera: ClassVar[dict[str, Any]] = {
        "trackbodyid": 1, "distance": 0.5, "azimuth": 90.0, "elevation": -12.0,
    }  # fmt: skip

    medium: str | Path | Medium = "play_sand"
    law: str | Law | None = "link_distributed"
    resolution: int | None = None
    target_range: tuple[float, float] = (0.06, 0.2)
    speed_range: tuple[float, float] = (1.0, 5.0)
    frame_skip: int = 500

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("target_range", "speed_range"):
            low, high = getattr(self, name)
            if not 0 < low <= high < math.inf:
                raise InputError(f"{name} must be positive and finite, not {(low, high)}")
        if self.rigid is not None:
            raise InputError("LinkDrop drops a link into sand: omit rigid")

    @cached_property
    def action_space(self) -> Box:
        return Box(-1.0, 1.0, (2,), np.float32)

    def robot(self) -> mujoco.MjSpec:
        spec = self.link.spec()
        spec.option.timestep = 5e-4
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.nuserdata = 2
        spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 1])
        spec.delete(spec.geom("bed"))
        spec.delete(spec.geom("table"))
        return spec

    def start(self, random: np.random.Generator, height: Callable[[float, float], float]) -> Start:
        target, speed = random.uniform(*self.target_range), random.uniform(*self.speed_range)
        qpos = np.array([0.0, self.link.length / 2 + height(0.0, 0.0), 0.0])
        return Start(qpos, np.array([0.0, -speed, 0.0]), np.array([target, speed]))

    def act(self, action: np.ndarray, state: State) -> np.ndarray:
        half, release = self.link.length / 2, np.clip(action, -1.0, 1.0)
        for row in range(len(action)):  # one by one: NumPy's sine may differ in long arrays
            angle = STEEPEST * (float(release[row, 0]) + 1) / 2
            place, height, _ = state.qpos[row]  # upright, its lower end on the ground
            centre = place - half * math.sin(angle), height - half + half * math.cos(angle)
            state.qpos[row] = *centre, angle
            # The lower end moves down at the given speed for any spin.
            spin, speed = FASTEST * float(release[row, 1]), state.userdata[row, 1]
            state.qvel[row] = 0.0, -speed - half * math.sin(angle) * spin, spin
        return np.zeros((len(action), 0))

    def observe(self, state: State) -> np.ndarray:
        return np.array(state.userdata)

    def rewards(self, before: Any, action: np.ndarray, state: State) -> dict[str, np.ndarray]:
        depth = self.figures.read(state.sensordata, state.active, state.slope)["sand/depth"]
        return {"reward_depth": -np.abs(depth / self.link.length - state.userdata[:, 0])}

    def terminated(self, state: State) -> np.ndarray:
        return np.ones(len(state.qpos), bool)

    def place(self, state: State) -> dict[str, np.ndarray]:
        return {"target": state.userdata[:, 0].copy(), "angle": state.qpos[:, 2].copy()}
