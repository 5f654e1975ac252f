"""Gymnasium environments on sand: Gymnasium's robots, and ours.

Importing this registers the ids, as does `mjgranular` after `gymnasium`;
`gymnasium.make("mjgranular:mjgranular/ChainSwim-v0")` does both at once.

`ground` puts sand under a model; `robots` does so for Gymnasium's environments. A `Task` defines an
environment, for any number of simulations at once; `SandEnv` runs one of them, `SandVectorEnv` many
in threads, and `WarpVectorEnv` many in MuJoCo Warp. `ranges` define sand sampled at each reset.
"""

from mjgranular._util.checks import require

for _package in ("gymnasium", "gymnasium.envs.mujoco.mujoco_env", "imageio"):
    require(_package, extra="envs", purpose="mjgranular.envs")

from mjgranular.envs.ranges import SandRanges as SandRanges
from mjgranular.envs.robots import on_sand as on_sand
from mjgranular.envs.single import SandEnv as SandEnv
from mjgranular.envs.task import Start as Start
from mjgranular.envs.task import State as State
from mjgranular.envs.task import Task as Task
from mjgranular.envs.task import tasks as tasks
from mjgranular.envs.vector import SandVectorEnv as SandVectorEnv
from mjgranular.envs.vector import WarpVectorEnv as WarpVectorEnv
