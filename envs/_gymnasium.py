"""Error on import, with the install line, if Gymnasium or its MuJoCo dependency is missing."""

from mjgranular._util.extras import need

need("gymnasium", extra="envs", purpose="mjgranular.envs")
need("gymnasium.envs.mujoco.mujoco_env", extra="envs", purpose="mjgranular.envs")
need("imageio", extra="envs", purpose="mjgranular.envs")
