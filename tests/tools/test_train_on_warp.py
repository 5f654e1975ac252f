"""Training in MuJoCo Warp, on its CPU back end: runs as any other; what cannot be is refused."""

import json
import re

import numpy as np
import pytest

from mjgranular.cli import main

pytestmark = pytest.mark.slow
pytest.importorskip("mujoco_warp")
HOPPER = "mjgranular/Hopper-v0"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([HOPPER, "--device", "cpu"], "--device is for --engine warp"),
        ([HOPPER, "--engine", "warp", "--device", "gpu9"], "no device 'gpu9' .* there is: cpu"),
        ([HOPPER, "--engine", "warp", "--set", "num_envs=0"], "num_envs"),
        (
            ["Pendulum-v1", "--engine", "warp"],
            "environments of mjgranular.* not Pendulum-v1",
        ),
        (
            [HOPPER, "--engine", "warp", "--set", "environment.memory='cell=0.01 extent=0.1'"],
            "too small for surroundings",
        ),
    ],
)
def test_what_cannot_be_is_told_and_leaves_nothing(arguments, words, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    assert main(["train", *arguments]) == 2
    error = capfd.readouterr().err
    assert re.search(f"error: .*{words}", " ".join(error.split()))
    assert "Traceback" not in error
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_a_run_goes_on_here_and_there_and_needs_no_warp_to_be_evaluated(
    tmp_path, monkeypatch, capfd
):
    monkeypatch.chdir(tmp_path)
    there = ["--engine", "warp", "--device", "cpu"]
    small = [
        "--set",
        "num_envs=8",
        "n_steps=16",
        "batch_size=64",
        "checkpoint_every=256",
        "n_epochs=2",
    ]
    assert main(["train", HOPPER, *there, "--total-steps", "256", *small]) == 0
    out, error = capfd.readouterr()
    assert "256 steps" in out
    # One line in place of one for each of Warp's modules.
    assert not re.search(r"(?m)^(Module|Warp) (?!CUDA)", out + error)
    run = "runs/Hopper-v0-ppo-0"
    assert main(["train", "--resume", run, "--total-steps", "512"]) == 0
    assert main(["train", "--resume", run, "--total-steps", "768", *there]) == 0
    capfd.readouterr()
    assert main(["evaluate", run, "--seeds", "2", "--json"]) == 0
    scores = json.loads(capfd.readouterr().out)
    assert np.isfinite(scores[0]["return"]["mean"])


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of packages that RSL-RL imports
def test_rsl_rl_learns_in_worlds_of_mujoco_warp():
    rsl_rl = pytest.importorskip("rsl_rl.runners")
    import torch

    from mjgranular import InputError
    from mjgranular.envs import WarpVectorEnv
    from mjgranular.envs.rsl import RslVecEnv

    with pytest.raises(InputError, match="autoreset_mode='SameStep'"):
        RslVecEnv(WarpVectorEnv("Hopper", 2, device="cpu"))
    worlds = WarpVectorEnv(
        "Hopper", 8, device="cpu", max_episode_steps=20, autoreset_mode="SameStep"
    )
    env = RslVecEnv(worlds)
    env.seed(0)
    lengths, over = [], torch.zeros(8)
    for _ in range(21):
        observations, rewards, dones, extras = env.step(torch.full((8, 3), 9.0))
        assert observations["policy"].shape == (8, 11)
        assert rewards.shape == dones.shape == extras["time_outs"].shape == (8,)
        assert not (extras["time_outs"] & ~dones).any()
        over += dones
        lengths.append(env.episode_length_buf.clone())
    assert (over >= 1).all()
    assert torch.stack(lengths).max() < 20

    mlp = {"class_name": "MLPModel", "hidden_dims": [16], "obs_normalization": True}
    noise = {"class_name": "GaussianDistribution", "init_std": 1.0, "std_type": "scalar"}
    settings = {
        "num_steps_per_env": 8,
        "save_interval": 50,
        "obs_groups": {"actor": ["policy"], "critic": ["policy"]},
        "actor": {**mlp, "activation": "tanh", "distribution_cfg": noise},
        "critic": {**mlp, "activation": "tanh"},
        "algorithm": {"class_name": "PPO", "num_learning_epochs": 2, "num_mini_batches": 2},
    }
    runner = rsl_rl.OnPolicyRunner(env, settings, log_dir=None, device="cpu")
    before = [each.detach().clone() for each in runner.alg.actor.parameters()]
    runner.learn(2)
    after = list(runner.alg.actor.parameters())
    assert all(torch.isfinite(each).all() for each in after)
    assert any((one != other).any() for one, other in zip(before, after, strict=True))
