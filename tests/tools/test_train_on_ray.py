"""Training on Ray: what comes of it is a run as any other, and what cannot be is refused."""

import signal
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from mjgranular.cli import main
from mjgranular.errors import MissingExtraError
from mjgranular.learn import search
from mjgranular.learn.blocks import Actor, Evaluation, Job, run_evaluation
from mjgranular.learn.on_ray import _training, check_training, here
from mjgranular.learn.policies import load_policy
from mjgranular.learn.run import begin_run, open_run
from mjgranular.learn.scaling import ScaledEnvs, Scaling, Statistics
from mjgranular.learn.settings import change, find_settings
from mjgranular.learn.train import train
from mjgranular.pool import Workers

ID = "Pendulum-v1"
CRAWL = "mjgranular/ChainCrawl-v0"
TINY = ("num_envs=4", "n_steps=64", "batch_size=64", "n_epochs=2", "checkpoint_every=512")


def settings(*changes):
    return change(find_settings(ID, algorithm="ppo"), [*TINY, *changes])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--env-runners", "2"], "--env-runners is for --engine ray"),
        (["--address", "auto"], "say --engine ray too"),
        (["--engine", "ray", "--env-runners", "3"], "8 environments .* among 3 env runners: 2 can"),
        (["--engine", "ray", "--env-runners", "0"], "at least 1 worker"),
        (["--engine", "ray", "--algorithm", "sac"], "trains with ppo, not sac"),
        (["--engine", "ray", "--processes"], "leave processes away"),
        (["--engine", "ray", "--set", "clip_range_vf=0.2"], "nothing like clip_range_vf"),
        (["--engine", "ray", "--set", "normalize_advantage=false"], "like normalize_advantage"),
        (["--engine", "ray", "--set", "clip_range=linear_0.2"], "clip_range does not fall"),
        (["--engine", "ray", "--set", "policy.squash_output=true"], "like policy.squash_output"),
    ],
)
def test_what_cannot_be_is_told_and_leaves_nothing(arguments, words, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    assert main(["train", ID, *arguments]) == 2
    error = capfd.readouterr().err
    assert error.startswith("error: ")
    assert error.count("\n") <= 3
    assert __import__("re").search(words, " ".join(error.split()))
    assert list(tmp_path.iterdir()) == []


def test_without_rllib_the_install_line_is_given(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.delitem(sys.modules, "ray.rllib.algorithms.ppo", raising=False)
    with pytest.raises(MissingExtraError, match=r"mjgranular\[ray\]"):
        check_training(settings(), Workers("ray", 2))


def test_a_rate_goes_on_falling_from_where_it_was():
    falling = settings("learning_rate=linear_1e-3", "total_steps=1000")
    assert _training(falling, 0)["lr"] == [[0, 1e-3], [1000, 0.0]]
    assert _training(falling, 750)["lr"] == [[0, 0.25e-3], [250, 0.0]]


def test_the_process_that_learns_has_one_environment_and_all_steps(tmp_path):
    run = begin_run(tmp_path / "run", ID, settings(), seed=0)
    alone = here(run).settings
    assert (alone.num_envs, alone.arguments["n_steps"]) == (1, 4 * 64)


class Seen(gym.vector.VectorWrapper):
    """Remembers what was observed."""

    def reset(self, **how):
        observations, info = super().reset(**how)
        self.seen = [observations]
        return observations, info

    def step(self, actions):
        found = super().step(actions)
        self.seen.append(found[0])
        return found


def scaled(num_envs=3):
    env = Seen(gym.make_vec(ID, num_envs=num_envs, vectorization_mode="sync"))
    return ScaledEnvs(env, Scaling(True, True, 0.97, 10.0, 1e-8))


def test_environments_are_normalised_as_by_stable_baselines():
    env = scaled()
    env.known = Statistics.none((3,))
    theirs = VecNormalize(DummyVecEnv([lambda: gym.make(ID)] * 3), gamma=0.97)
    for statistics in (theirs.obs_rms, theirs.ret_rms):
        statistics.count = 0.0  # it begins with one in 10,000
    theirs.seed(5)
    expected = theirs.reset()
    observations, _ = env.reset(seed=[5, 6, 7])
    np.testing.assert_allclose(observations, expected, rtol=1e-6, atol=1e-6)
    draw = np.random.default_rng(0)
    for _ in range(199):  # the last step of their first episodes begins the next
        actions = draw.uniform(-2, 2, (3, 1)).astype(np.float32)
        expected, reward, *_ = theirs.step(actions)
        observations, rewards, *_ = env.step(actions)
        np.testing.assert_allclose(observations, expected, rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(rewards, reward, rtol=1e-5)
    env.step(np.zeros((3, 1), np.float32))
    _, episodes = env.take()
    assert [length for _, length in episodes] == [200, 200, 200]
    env.close()
    theirs.close()


def test_statistics_of_several_workers_are_those_of_all_that_they_saw():
    workers = [scaled(), scaled(2)]
    known = Statistics.none((3,))
    draw = np.random.default_rng(0)
    for rollout in range(3):
        for number, env in enumerate(workers):
            # A copy: each worker goes on with its own.
            env.known = Statistics(*(each.copy() for each in known))
            if rollout == 0:
                env.reset(seed=number)
            for _ in range(150):
                env.step(draw.uniform(-2, 2, (env.num_envs, 1)).astype(np.float32))
        for env in workers:
            known.join(env.take()[0])
    values = np.concatenate([part for env in workers for part in env.env.seen])
    assert known.observations.count == len(values)
    np.testing.assert_allclose(known.observations.mean, values.mean(axis=0), rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(known.observations.var, values.var(axis=0), rtol=1e-5)


@pytest.fixture(scope="module")
def session():
    ray = pytest.importorskip("ray", reason="the extra ray is not installed")
    pytest.importorskip("tree", reason="the extra ray is not installed")
    ray.init(
        num_cpus=2,
        include_dashboard=False,
        logging_level="ERROR",
        log_to_driver=False,
        address="local",
        object_store_memory=80 * 2**20,
    )
    yield ray
    ray.shutdown()


WITHOUT_RAY = """
import sys
sys.modules["ray"] = None
from mjgranular.cli import main
sys.exit(main(["evaluate", sys.argv[1], "--seeds", "2", "--json"]))
"""


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of Ray's and RLlib's own ways
def test_what_ray_has_trained_is_a_run_as_any_other(session, tmp_path, monkeypatch):
    """Begun here, gone on with there, stopped, ended here, evaluated without Ray."""
    from mjgranular.learn import rllib

    distances = []

    def first(learner, module_id, batch, fwd_out, old=rllib.SandLearner._distance):
        distances.append(old(learner, module_id, batch, fwd_out))
        return distances[-1]

    monkeypatch.setattr(rllib.SandLearner, "_distance", first)
    chosen = settings("use_sde=true", "sde_sample_freq=8", "target_kl=0.1", "total_steps=2048")
    run = begin_run(tmp_path / "run", ID, chosen, seed=3, engine="ray")
    assert run.versions["ray"] == session.__version__
    began = signal.getsignal(signal.SIGTERM)

    def stop(steps, _newest, after=500):
        if steps >= after:
            signal.raise_signal(signal.SIGTERM)

    with run.locked():
        stopped = train(run, report=stop)  # here
    assert stopped.stopped_by == signal.SIGTERM
    assert distances == []
    with run.locked():
        again = train(
            open_run(run.path), on=Workers("ray", 2), report=lambda *told: stop(*told, after=1500)
        )
    assert again.stopped_by == signal.SIGTERM
    assert signal.getsignal(signal.SIGTERM) == began
    assert again.began == stopped.progress.steps
    assert 1500 <= again.progress.steps < 2048
    # The policy that sampled is the one that learns: without a step they are no way apart.
    assert distances[0] < 1e-9
    assert not (run.path / "policy.zip").exists()
    assert session.is_initialized()
    with run.locked():
        done = train(open_run(run.path))  # here again
    assert done.stopped_by is None
    assert done.began == again.progress.steps
    assert done.progress.steps >= 2048
    steps = [row[0] for row in done.progress.curve]
    assert steps == sorted(set(steps))
    assert sum(row[2] for row in done.progress.curve) >= 4

    policy = load_policy(run.path)
    assert policy.normalizer is not None
    loaded = PPO.load(run.path / "policy.zip", device="cpu")
    state = policy.model.state_dict()
    assert all(
        torch.equal(value, state[name]) for name, value in loaded.policy.state_dict().items()
    )
    evaluated = subprocess.run(
        [sys.executable, "-c", WITHOUT_RAY, str(run.path)], capture_output=True, text=True
    )
    assert evaluated.returncode == 0, evaluated.stderr
    assert '"return"' in evaluated.stdout


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_evaluations_and_searches_are_the_same_to_the_bit(session, monkeypatch):
    policy = Actor("one", CRAWL, {"frame_skip": 2}, load_policy("ChainCrawl-v0/ppo-1"))
    draws = Actor("two", ID, {}, "random")
    evaluation = Evaluation([Job(policy, "max_episode_steps=20"), Job(draws)], 3)
    expected = run_evaluation(evaluation)
    short = {"frame_skip": 2, "max_episode_steps": 20}
    monkeypatch.setattr(search, "AT_ONCE", 4)
    found = search.search_gaits(CRAWL, short, count=8)
    assert len(found.gaits) == 16
    for on in (Workers("local", 2), Workers("ray", 2)):
        scores = run_evaluation(evaluation, on=on)
        for mine, theirs in zip(scores, expected, strict=True):
            assert mine.as_json() == theirs.as_json()
            assert np.array_equal(mine.episodes.returns, theirs.episodes.returns)
        assert search.search_gaits(CRAWL, short, count=8, on=on) == found


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("env_id", "changes"), [(ID, ()), (ID, ("use_sde=true",)), ("CartPole-v1", ())]
)
def test_probabilities_of_rllib_are_those_of_stable_baselines(session, env_id, changes):
    from mjgranular.learn.rllib import SandModule

    env = gym.make(env_id)
    chosen = change(settings("policy.log_std_init=-0.7"), changes)
    torch.manual_seed(0)
    module = SandModule(
        observation_space=env.observation_space,
        action_space=env.action_space,
        model_config={"settings": chosen.as_json()},
    )
    module.begin_rollout(4)
    observations = torch.as_tensor(np.stack([env.observation_space.sample() for _ in range(4)]))
    observations = torch.clip(observations, -3, 3)
    out = module.forward_exploration({"obs": observations})
    values, logs, entropy = module.policy.evaluate_actions(observations, out["actions"])
    assert torch.allclose(out["action_logp"], logs)
    trained = module.forward_train({"obs": observations})["action_dist_inputs"]
    theirs = module.get_train_action_dist_cls().from_logits(trained)
    assert torch.allclose(theirs.logp(out["actions"]), logs, atol=1e-5)
    assert torch.allclose(theirs.entropy(), entropy, atol=1e-5)
    assert torch.allclose(module.compute_values({"obs": observations}), values.squeeze(-1))
