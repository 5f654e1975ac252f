"""Train a policy with PPO of RLlib on a local Ray cluster, and save it.

python scripts/train_rllib.py mjgranular/ChainSwim-v0 100 policy

`ray.init(address="auto")` in place of the local cluster uses the one that this machine belongs to.
"""

import sys
from pathlib import Path

import ray
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.connectors.env_to_module import MeanStdFilter

from mjgranular.envs.rllib import register_env


def main(
    env_id: str = "mjgranular/ChainSwim-v0", iterations: str = "100", out: str = "policy"
) -> None:
    """Train for `iterations` iterations of 4096 steps each, sampled by two env runners."""
    ray.init(address="local", num_cpus=2, include_dashboard=False)
    config = (
        PPOConfig()
        .environment(register_env(env_id), env_config={"threads": 1})
        .env_runners(
            num_env_runners=2,
            num_envs_per_env_runner=8,
            gym_env_vectorize_mode="vector_entry_point",
            rollout_fragment_length=256,
            sample_timeout_s=600,  # RLlib drops samples that take longer; the first one compiles
            env_to_module_connector=lambda *_: MeanStdFilter(),
        )
        .training(
            train_batch_size_per_learner=4096,
            minibatch_size=256,
            num_epochs=10,
            lr=3e-4,
            grad_clip=0.5,
            use_kl_loss=False,
            vf_clip_param=float("inf"),
        )
        .debugging(seed=0, log_level="ERROR")
    )
    algorithm = config.build_algo()
    for iteration in range(int(iterations)):
        sampled = algorithm.train()["env_runners"]
        steps, mean = sampled["num_env_steps_sampled_lifetime"], sampled.get("episode_return_mean")
        reached = "no episode ended" if mean is None else f"mean return {mean:.4g}"
        print(f"{iteration + 1}: {steps:.0f} steps, {reached}", flush=True)
    print(f"saved in {algorithm.save_to_path(str(Path(out).absolute()))}")
    algorithm.stop()
    ray.shutdown()


if __name__ == "__main__":
    main(*sys.argv[1:])
