"""Says on import what to install where Gymnasium, or what its robots need, is missing."""

from mjgranular._util.extras import need

need("gymnasium", extra="envs", purpose="mjgranular.envs")
need("gymnasium.envs.mujoco.mujoco_env", extra="envs", purpose="mjgranular.envs")
need("imageio", extra="envs", purpose="mjgranular.envs")
