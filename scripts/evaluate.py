"""Evaluate a policy from scripts/train.py, over ten episodes.

python scripts/evaluate.py mjgranular/ChainSwim-v0 policy
"""

import sys

import gymnasium as gym
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

import mjgranular.envs  # noqa: F401  registers its environments


def main(env_id: str = "mjgranular/ChainSwim-v0", folder: str = "policy") -> None:
    """Print the mean return; `mjgranular evaluate` also does other sands, with intervals."""
    plain = DummyVecEnv([lambda: Monitor(gym.make(env_id))])
    env = VecNormalize.load(f"{folder}/normalizer.pkl", plain)
    env.training, env.norm_reward = False, False
    env.seed(10_000)
    model = PPO.load(f"{folder}/policy.zip", device="cpu")
    returns, _ = evaluate_policy(model, env, n_eval_episodes=10, return_episode_rewards=True)
    print(f"{env_id}: {np.mean(returns):.4g}, standard deviation {np.std(returns, ddof=1):.2g}")


if __name__ == "__main__":
    main(*sys.argv[1:])
