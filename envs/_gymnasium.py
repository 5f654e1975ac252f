"""Error on import, with the install line, if Gymnasium or its MuJoCo dependency is missing."""

from mjgranular._util.checks import require

require("gymnasium", extra="envs", purpose="mjgranular.envs")
require("gymnasium.envs.mujoco.mujoco_env", extra="envs", purpose="mjgranular.envs")
require("imageio", extra="envs", purpose="mjgranular.envs")
