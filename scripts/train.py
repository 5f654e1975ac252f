"""Train a policy on sand with Stable-Baselines3 alone, and save it with its normalizer.

python scripts/train.py mjgranular/ChainSwim-v0 100000 policy
"""

import sys
from pathlib import Path

import gymnasium as gym
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecNormalize

import mjgranular.envs  # noqa: F401  registers its environments


def main(
    env_id: str = "mjgranular/ChainSwim-v0", steps: str = "100000", folder: str = "policy"
) -> None:
    """Train for `steps` steps; `mjgranular train` adds checkpoints and tuned settings."""
    env = VecNormalize(make_vec_env(lambda: gym.make(env_id), n_envs=4, seed=0))
    model = PPO("MlpPolicy", env, n_steps=512, batch_size=256, seed=0, device="cpu")
    model.learn(int(steps))
    out = Path(folder)
    out.mkdir(parents=True, exist_ok=True)
    model.save(out / "policy.zip")
    env.save(str(out / "normalizer.pkl"))
    print(f"{env_id}: {steps} steps, saved in {out}")


if __name__ == "__main__":
    main(*sys.argv[1:])
