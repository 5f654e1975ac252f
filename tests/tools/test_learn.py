"""Training: what is interrupted goes on, what is wrong is refused, what is counted is right."""

import json
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from scipy import stats
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from mjgranular._util import files
from mjgranular.cli import main
from mjgranular.cli.console import print_json
from mjgranular.errors import (
    GranularWarning,
    InputError,
    MissingExtraError,
    OutputError,
    UnknownNameError,
)
from mjgranular.learn.checkpoint import Normalizer
from mjgranular.learn.evaluate import evaluate, make_baseline, mean_of, parse_variant, run_episodes
from mjgranular.learn.policies import POLICY_FILES, load_policy
from mjgranular.learn.run import Run, begin_run, mean_returns, open_run
from mjgranular.learn.settings import (
    FOLDER,
    Settings,
    change,
    find_settings,
    settings_file,
)
from mjgranular.learn.train import train
from mjgranular.medium.file import EXAMPLE

ID = "Pendulum-v1"
QUICK = {
    "ppo": ("n_steps=64", "batch_size=64", "n_epochs=2"),
    "sac": (
        "learning_starts=100",
        "buffer_size=2000",
        "train_freq=8",
        "gradient_steps=2",
        "net=[16, 16]",
    ),
    "td3": (
        "learning_starts=100",
        "buffer_size=2000",
        "train_freq=8",
        "gradient_steps=2",
        "net=[16, 16]",
    ),
}


def quick(algorithm: str = "ppo", *changes: str) -> Settings:
    """Settings for some hundred steps."""
    few = ("num_envs=2", "checkpoint_every=512", "total_steps=1152")
    return change(find_settings(ID, algorithm=algorithm), (*few, *QUICK[algorithm], *changes))


def weights(run: Run) -> np.ndarray:
    """All numbers of a run's policy."""
    parameters = load_policy(run.path).model.state_dict().values()
    return np.concatenate([p.numpy().ravel() for p in parameters])


class Killed(BaseException):
    """As good as a lost machine: nothing catches it."""


def kill_after(steps: int):
    def report(done: int, _newest: float | None) -> None:
        if done > steps:
            raise Killed

    return report


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> Run:
    run = begin_run(tmp_path_factory.mktemp("runs") / "pendulum", ID, quick(), seed=3)
    train(run)
    return run


@pytest.mark.parametrize(
    "algorithm", ["ppo", *(pytest.param(name, marks=pytest.mark.slow) for name in ("sac", "td3"))]
)
def test_a_killed_and_resumed_run_is_the_uninterrupted_one_to_the_last_bit(algorithm, tmp_path):
    settings = quick(algorithm)
    whole = begin_run(tmp_path / "whole", ID, settings, seed=5)
    assert train(whole).progress.steps == 1152
    broken = begin_run(tmp_path / "broken", ID, settings, seed=5)
    with pytest.raises(Killed):
        train(broken, report=kill_after(1100))
    assert [folder.name for folder in broken.checkpoints()] == [
        "step-0000001024",
        "step-0000000512",
    ]
    training = train(open_run(broken.path))
    assert training.progress.steps == 1152
    assert training.stopped_by is None
    np.testing.assert_array_equal(weights(broken), weights(whole))
    a, b = (load_policy(run.path).normalizer for run in (whole, broken))
    np.testing.assert_array_equal(a.mean, b.mean)
    texts = [(run.path / "curve.csv").read_text() for run in (whole, broken)]
    rows = [[line.split(",") for line in text.splitlines()] for text in texts]
    assert len(rows[0]) >= 3
    assert [(row[0], *row[2:]) for row in rows[0]] == [(row[0], *row[2:]) for row in rows[1]]


def test_a_training_goes_on_from_the_policy_of_another(trained, tmp_path):
    still = quick("ppo", f"start_from={trained.path}", "learning_rate=1e-12", "total_steps=128")
    run = begin_run(tmp_path / "on", ID, still, seed=4)
    train(run)
    np.testing.assert_allclose(weights(run), weights(trained), rtol=1e-4, atol=1e-8)
    old, new = load_policy(trained.path).normalizer, load_policy(run.path).normalizer
    assert new.count == old.count + 2 + 128  # a reset, and the steps
    assert 0.0 < np.abs(new.mean - old.mean).max() < 0.5
    loud = begin_run(tmp_path / "loud", ID, change(still, ["policy.log_std_init=0.7"]), seed=4)
    train(loud)
    assert load_policy(loud.path).model.log_std.item() == pytest.approx(0.7, abs=1e-3)
    assert abs(load_policy(trained.path).model.log_std.item()) < 0.1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            "net=[32]",
            r"has algorithm 'ppo', net \[64, 64\].*this run has algorithm 'ppo', net \[32\]",
        ),
        ("activation=relu", "activation 'tanh'.* but this run has .*activation 'relu'"),
        ("use_sde=true", "do not fit: policy and use_sde must be as in its settings"),
        ("start_from=nowhere", "no run folder or policy 'nowhere'"),
    ],
)
def test_a_policy_that_does_not_fit_starts_nothing(change, message, trained, tmp_path):
    settings = quick("ppo", f"start_from={trained.path}", change)
    run = begin_run(tmp_path / "run", ID, settings, seed=3)
    with pytest.raises(InputError, match=message):
        train(run)


def padded(more: int = 2, observe_sand: bool = False, **given: Any) -> gym.Env:
    """The pendulum with more observations."""
    space = gym.spaces.Box(-np.inf, np.inf, (3 + more,), np.float32)
    env = gym.make(ID, **given)
    return gym.wrappers.TransformObservation(env, lambda seen: np.append(seen, seen[:more]), space)


def test_observations_that_are_new_begin_with_no_weight(trained, tmp_path, monkeypatch):
    spec = gym.envs.registration.EnvSpec("Padded-v0", entry_point=padded)
    monkeypatch.setitem(gym.registry, "Padded-v0", spec)
    still = quick("ppo", f"start_from={trained.path}", "learning_rate=1e-12", "total_steps=128")
    run = begin_run(tmp_path / "on", "Padded-v0", still, seed=4)
    train(run)
    old, new = (load_policy(one.path) for one in (trained, run))
    seen = np.array([[0.5, -0.2, 0.1]])
    same = replace(new, normalizer=old.normalizer.widened(5))
    more = np.array([[0.5, -0.2, 0.1, 9.0, -9.0]])
    np.testing.assert_allclose(same.act(more, [0]), old.act(seen, [0]), rtol=1e-4, atol=1e-6)
    with pytest.raises(InputError, match="the observations of Pendulum-v1 must be those of"):
        train(begin_run(tmp_path / "back", ID, quick("ppo", f"start_from={run.path}"), seed=4))
    sees = quick("ppo", "environment.observe_sand=true", "total_steps=128")
    run = begin_run(tmp_path / "sees", "Padded-v0", sees, seed=4)
    train(run)
    wider = quick("ppo", f"start_from={run.path}", "environment.more=3")
    with pytest.raises(InputError, match="observes the sand after all else"):
        train(begin_run(tmp_path / "wider", "Padded-v0", wider, seed=4))


def test_files_of_an_environment_are_noted_with_absolute_paths(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("beach.yaml").write_text(EXAMPLE)
    name, few = "mjgranular/LinkDrop-v0", ["environment.medium=beach.yaml"]
    settings = change(find_settings(name), few)
    begin_run("run", name, settings, seed=0)
    monkeypatch.chdir("run")
    assert open_run(Path()).arguments["medium"] == str(tmp_path / "beach.yaml")


def test_options_of_an_environment_may_be_infinite(tmp_path):
    settings = quick("ppo", "environment.g=inf")
    begin_run(tmp_path / "run", ID, settings, seed=0)
    assert open_run(tmp_path / "run").settings == settings


def test_json_on_standard_output_has_words_for_numbers_that_are_not_finite(capfd):
    print_json({"g": [math.inf, -math.inf, math.nan, 1.5], "a": {"b": True}})
    assert json.loads(capfd.readouterr().out) == {
        "g": ["inf", "-inf", "nan", 1.5],
        "a": {"b": True},
    }


def test_means_are_over_as_many_episodes_as_there_are_environments():
    curve = [(10, 0.1, 1, 2.0, 5), (20, 0.2, 3, 10.0, 9), (30, 0.3, 4, 20.0, 9), (40, 0.4, 1, 0, 2)]
    assert mean_returns(curve, 4) == [(20, 8.0), (30, 20.0)]
    assert mean_returns(curve[:1], 4) == [(10, 2.0)]
    assert mean_returns((), 4) == []


@pytest.mark.slow
def test_another_seed_is_another_policy(trained, tmp_path):
    """That the same seed is the same policy is seen where a run is killed and resumed."""
    other = begin_run(tmp_path / "other", ID, trained.settings, seed=4)
    train(other)
    assert not np.array_equal(weights(other), weights(trained))


def test_damaged_checkpoints_are_skipped_with_one_sentence(tmp_path):
    run = begin_run(
        tmp_path / "run", ID, quick("ppo", "total_steps=512", "checkpoint_every=256"), seed=0
    )
    train(run)
    newest, older = run.checkpoints()
    file = newest / "policy.zip"
    file.write_bytes(file.read_bytes()[:-100])  # as a full disk leaves it
    with pytest.warns(GranularWarning, match=r"step-0000000512 is damaged \(policy.zip is not"):
        assert run.newest_checkpoint() == older
    (newest / "policy.zip").unlink()
    with pytest.warns(GranularWarning, match="policy.zip is missing"):
        assert run.steps() == 256
    (newest / files.MANIFEST).unlink()
    with pytest.warns(GranularWarning, match="cannot be read"):
        assert train(run).progress.steps == 512
    assert run.newest_checkpoint() == newest  # made anew
    (run.path / "policy.zip").write_bytes(b"not a zip")
    load_policy(run.path)  # the newest checkpoint's
    with pytest.raises(OutputError, match=r"policy.zip is damaged"):
        load_policy(run.path / "policy.zip")


def test_one_of_two_that_begin_the_same_run_is_refused(tmp_path):
    """The folder is locked before it is looked at: no configuration over others' checkpoints."""
    with files.locked(tmp_path / "run"), pytest.raises(OutputError, match="in use by another"):
        begin_run(tmp_path / "run", ID, quick(), seed=1)
    first = begin_run(tmp_path / "run", ID, quick(), seed=1)
    (tmp_path / "run" / ".lock").touch()  # a killed process leaves one that nobody holds
    with pytest.raises(OutputError, match="holds a training run already"):
        begin_run(tmp_path / "run", ID, quick(), seed=2)
    assert open_run(first.path).seed == 1


@pytest.mark.parametrize("left", [(), ("policy.zip",), ("policy.zip", "curve.csv")])
def test_what_was_killed_after_its_last_checkpoint_is_finished(left, trained, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(trained.path, folder)
    for name in ("policy.zip", "normalizer.json", "curve.csv"):
        if name not in left:
            (folder / name).unlink()
    (folder / ".publish.part0").mkdir()
    assert train(open_run(folder)).progress.steps == 1152
    for name in ("policy.zip", "normalizer.json", "curve.csv"):
        assert (folder / name).read_bytes() == (trained.path / name).read_bytes()
    assert not list(folder.glob(".*"))


def test_a_signal_after_the_last_step_stops_nothing(tmp_path, monkeypatch):
    from stable_baselines3 import PPO

    learn = PPO.train

    def signalled(model):
        learn(model)
        if model.num_timesteps >= 512:
            os.kill(os.getpid(), signal.SIGTERM)

    monkeypatch.setattr(PPO, "train", signalled)
    run = begin_run(tmp_path / "run", ID, quick("ppo", "total_steps=512"), seed=0)
    assert train(run).stopped_by is None
    assert (run.path / "policy.zip").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (None, "normalizer.json cannot be read"),
        ({"mean": [0.0]}, r"mean and variance finite numbers of shape \(3,\)"),
        ({"mean": 0.0}, "mean and variance finite"),
        ({"variance": ["x"] * 3}, "is damaged"),
        ({"observations": False}, "observations must be True"),
        ({"clip": None}, "is damaged"),
    ],
)
def test_a_policy_without_its_normaliser_does_not_act(change, message, trained, tmp_path):
    for name in POLICY_FILES:
        (tmp_path / name).write_bytes((trained.path / name).read_bytes())
    file = tmp_path / "normalizer.json"
    if change is None:
        file.unlink()
    else:
        file.write_text(json.dumps({**json.loads(file.read_text()), **change}))
    with pytest.raises(OutputError, match=message):
        load_policy(tmp_path)


def test_a_folder_appears_whole_or_not_at_all(tmp_path):
    def fill(folder: Path) -> None:
        (folder / "a").write_text("half")
        raise OSError(28, "No space left on device")

    with pytest.raises(OutputError, match="No space left on device"):
        files.write_folder(tmp_path / "checkpoint", fill)
    assert list(tmp_path.iterdir()) == []
    (tmp_path / ".step-1.part99").mkdir()
    (tmp_path / ".curve.csv.part99").write_text("")
    files.remove_leftovers(tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_the_command_ends_with_a_checkpoint_on_sigterm_and_goes_on_after_sigkill(tmp_path):
    folder = tmp_path / "run"
    # Far more steps than are waited for.
    small = ["num_envs=2", "checkpoint_every=512", *QUICK["ppo"]]
    command = [sys.executable, "-m", "mjgranular", "train"]
    begin = [*command, ID, "--total-steps", "10000000", "--out", str(folder), "--set", *small]

    def wait_for(steps: int, process: subprocess.Popen) -> None:
        deadline = time.monotonic() + 600
        while not any(
            int(path.name.partition("-")[2]) >= steps for path in folder.glob("checkpoints/step-*")
        ):
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.05)

    def start(arguments: list[str]) -> subprocess.Popen:
        return subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)

    process = start(begin)
    wait_for(512, process)
    # While it runs, nobody else may write there.
    with pytest.raises(OutputError, match="in use by another process"), open_run(folder).locked():
        pass
    process.send_signal(signal.SIGTERM)
    said = process.communicate(timeout=600)[1].decode()
    assert process.returncode == 128 + signal.SIGTERM
    assert f"train --resume {folder}" in " ".join(said.split())
    stopped = open_run(folder).steps()
    assert stopped >= 512

    process = start([*command, "--resume", str(folder)])
    wait_for(stopped + 600, process)
    process.kill()
    process.communicate(timeout=600)
    killed = open_run(folder).steps()
    assert killed >= stopped + 512
    assert main(["train", "--resume", str(folder), "--total-steps", str(killed + 64)]) == 0
    assert open_run(folder).steps() >= killed + 64
    assert open_run(folder).settings.total_steps == killed + 64


def test_the_newest_policy_is_a_file_of_stable_baselines(trained):
    from stable_baselines3 import PPO

    assert PPO.load(trained.path / "policy.zip", device="cpu").num_timesteps == 1152
    config = json.loads((trained.path / "config.json").read_text())
    assert config["environment"] == ID
    assert config["seed"] == 3
    assert config["settings"]["total_steps"] == 1152
    assert config["versions"]["stable-baselines3"]
    assert list((trained.path / "tensorboard").iterdir())


def test_observations_are_normalised_as_in_training(tmp_path):
    def environments() -> VecNormalize:
        return VecNormalize(DummyVecEnv([lambda: gym.make(ID)] * 3))

    env = environments()
    env.seed(1)
    env.reset()
    for _ in range(50):
        env.step(np.zeros((3, 1), np.float32))
    file = tmp_path / "normalizer.json"
    file.write_text(json.dumps(Normalizer.of(env).as_json()))
    normalizer = Normalizer.read(file, quick(), (3,))
    seen = np.random.default_rng(0).normal(size=(5, 3)).astype(np.float32) * 30
    np.testing.assert_array_equal(normalizer(seen), env.normalize_obs(seen))
    other = environments()
    normalizer.restore(other)
    np.testing.assert_array_equal(other.obs_rms.var, env.obs_rms.var)
    assert other.ret_rms.count == env.ret_rms.count


def test_the_interval_is_students():
    values = [1.0, 2.0, 4.0, 8.0]
    mean = mean_of(values)
    low, high = stats.t.interval(0.95, 3, loc=np.mean(values), scale=stats.sem(values))
    assert (mean.mean, mean.low, mean.high) == pytest.approx((3.75, low, high))
    with pytest.raises(InputError, match="at least 2 seeds"):
        mean_of([1.0])


def test_episodes_are_those_of_the_single_environment():
    seeds = [11, 12, 13]
    several = run_episodes(
        "CartPole-v1", {}, lambda env: make_baseline("zero", "CartPole-v1", env), seeds
    )
    for k, seed in enumerate(seeds):
        env = gym.make("CartPole-v1")
        env.reset(seed=seed)
        total, steps, over = 0.0, 0, False
        while not over:
            _, reward, ended, cut, _ = env.step(0)
            total, steps, over = total + float(reward), steps + 1, ended or cut
        assert (several.returns[k], several.lengths[k]) == (total, steps)


def test_figures_of_info_are_means_over_the_episode():
    score = evaluate(
        "random", lambda env: make_baseline("random", "Swimmer-v5", env), "Swimmer-v5", {}, seeds=2
    )
    reached = score.episodes.figures["x_velocity"] * 1000 * 0.04  # steps of 0.04 s
    assert score.figure("nothing") is None
    assert np.all(score.episodes.lengths == 1000)
    # The return is the way forward over the time, less the cost of control.
    forward = score.episodes.figures["reward_forward"] * 1000
    np.testing.assert_allclose(forward * 0.04, reached)
    json.dumps(score.as_json(), allow_nan=False)


def test_the_random_agent_depends_on_the_seed_of_the_episode_alone():
    seeds, task = range(5, 8), "mjgranular/Hopper-v0"
    agent = partial(make_baseline, "random", task)
    together = run_episodes(task, {}, agent, seeds)
    apart = [run_episodes(task, {}, agent, [seed]).returns[0] for seed in seeds]
    assert together.returns.tolist() == apart


def test_another_environment_may_need_arguments(robots, capsys):
    command = ["evaluate", "Go1Velocity-v0/ppo-6", "--env", "mjgranular/Go2Velocity-v0"]
    command += ["--seeds", "2", "--json", "--on", "history=4,max_episode_steps=3"]
    assert main(command) == 0
    (score,) = json.loads(capsys.readouterr().out)
    assert score["variant"] == "history=4,max_episode_steps=3"
    assert score["length"]["mean"] == 3


def test_baselines():
    box = gym.spaces.Box(np.array([-1.0, 2.0]), np.array([1.0, 3.0]), dtype=np.float64)
    env = SimpleNamespace(action_space=box)
    zero, drawn = (make_baseline(name, "Box-v0", env) for name in ("zero", "random"))
    assert zero.act(np.zeros((2, 1)), np.zeros(2)).tolist() == [[0, 2], [0, 2]]
    assert drawn.act(np.zeros((4, 1)), np.zeros(4)).shape == (4, 2)


# Settings


@pytest.mark.parametrize("file", sorted(FOLDER.rglob("*.toml")), ids=lambda file: file.stem)
def test_settings_that_come_with_the_package_are_valid(file):
    for algorithm in ("ppo", "sac", "td3"):
        if f"[{algorithm}]" in file.read_text():
            settings = find_settings("", file=file, algorithm=algorithm)
            assert Settings.from_json(json.loads(json.dumps(settings.as_json()))) == settings


def test_an_environment_without_a_file_takes_the_default(tmp_path):
    assert settings_file("No-v0") == FOLDER / "default.toml"
    assert settings_file("../../secret") == FOLDER / "default.toml"


def test_settings_of_another_environment_are_taken_by_its_id():
    other = Path("mjgranular/Go1Velocity-v0")
    assert find_settings("No-v0", file=other) == find_settings(str(other))
    with pytest.raises(InputError, match="Go5"):
        find_settings("No-v0", file=Path("mjgranular/Go5Velocity-v0"))


def test_settings_are_changed_by_name():
    settings = change(
        find_settings(ID),
        ["gamma=0.9", "net=[32]", "policy.log_std_init=-1", "environment.g=5", "activation=relu"],
    )
    assert settings.arguments["gamma"] == 0.9
    assert settings.net == (32,)
    assert settings.policy == {"log_std_init": -1}
    assert settings.environment == {"g": 5}
    assert settings.activation == "relu"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("algorithm = 'ppo'\nsteps = 3", "no key 'steps'; there are: algorithm, environment"),
        ("algorithm = 'ppo'\n[ppo]\ntotal_steps = 3\nnum_env = 3", "no key 'num_env'"),
        ("algorithm = 'ppo'\n[ppo]\ntotal_steps = 3", "num_envs must be given"),
        (
            "algorithm = 'ppo'\n[ppo]\ntotal_steps = 1.5\nnum_envs = 1",
            "total_steps must be an integer",
        ),
        ("algorithm = 'dqn'\n[ppo]\ntotal_steps = 3\nnum_envs = 1", "no algorithm 'dqn'"),
        ("algorithm = 'sac'\n[ppo]\ntotal_steps = 3\nnum_envs = 1", "has settings for ppo"),
        ("algorithm = ", "is not TOML"),
        ("algorithm = 'ppo'\nppo = 3", "must be a mapping"),
        ("algorithm = 'ppo'\n[ppo]\ntotal_steps = 3\nnum_envs = 1\nnet = 'x'", "net must be"),
        (
            "algorithm = 'ppo'\n[ppo]\ntotal_steps = 3\nnum_envs = 1\n[ppo.arguments]\ngama = 1",
            "ppo has no argument 'gama'; it has: learning_rate",
        ),
        (
            "algorithm = 'ppo'\n[ppo]\ntotal_steps = 3\nnum_envs = 1\n[ppo.arguments]\ngamma = 'x'",
            "gamma must be a number",
        ),
        (
            "algorithm='ppo'\n[ppo]\ntotal_steps=3\nnum_envs=1\n[ppo.arguments]\nbatch_size=100",
            "batch_size must divide the 2048 steps",
        ),
    ],
)
def test_mistakes_in_settings_are_told(text, message, tmp_path):
    file = tmp_path / "my.toml"
    file.write_text(text)
    with pytest.raises((InputError, UnknownNameError)) as caught:
        find_settings("", file=file)
    assert message in str(caught.value)


# The command line


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["train", "Pendulm-v1"], "no environment 'Pendulm-v1'; did you mean Pendulum-v1"),
        (["train"], "train needs an environment"),
        (["train", ":Some-v0"], "the module '' of the environment :Some-v0 cannot be imported"),
        (["train", "Swimmer-v5", "--set", "environment.xml_file=x.xml"], "cannot be made"),
        (["train", ID, "--trust"], "--trust is for --resume"),
        (["train", ID, "--algorithm", "dqn"], "no algorithm 'dqn'; there are: ppo, sac, td3"),
        (["train", ID, "--settings", "none.toml"], "cannot read the settings none.toml"),
        (["train", ID, "--set", "gamma"], "NAME=VALUE"),
        (["train", ID, "--set", "environment.foo=3"], "cannot be made"),
        (["train", ID, "--set", "environment.a.b=3"], "names without dots"),
        (["train", ID, "--set", "learning_rate=-1"], "ppo: "),
        (["train", ID, "--seed", "-1"], "seed must be"),
        (["train", "CartPole-v1", "--algorithm", "sac"], "sac needs actions"),
        (["train", ID, "--set", "start_from=nowhere"], "no run folder or policy 'nowhere'"),
        (["train", "--resume", "nowhere"], "nowhere holds no training run"),
        (["train", ID, "--resume", "x"], "remove ENV"),
        (["evaluate", "nowhere"], "no run folder or policy 'nowhere'"),
        (["evaluate", ID], "--agent zero|random|gait"),
        (["evaluate", ID, "--agent", "nobody"], "no agent 'nobody'; there are: policy, zero"),
        (["evaluate", ID, "--agent", "gait"], "no scripted gait for Pendulum-v1"),
        (["evaluate", ID, "--agent", "zero", "--on", "g"], "NAME=VALUE,NAME=VALUE"),
        (["evaluate", ID, "--on", "g=1", "--on", "g=2"], "--on is given twice: give it once, with"),
        (["evaluate", ID, "--agent", "zero", "--seeds", "1"], "at least 2 seeds"),
    ],
)
def test_mistakes_are_told_in_one_sentence(arguments, message, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    captured = capfd.readouterr()
    assert message in captured.err
    assert "Traceback" not in captured.err
    assert captured.out == ""
    assert not list(tmp_path.glob("runs/*"))


def test_a_folder_with_something_in_it_is_left_alone(trained, tmp_path, capfd):
    (tmp_path / "diary.txt").write_text("mine")
    assert main(["train", ID, "--out", str(tmp_path)]) == 2
    assert "holds something already" in capfd.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["diary.txt"]
    before = weights(trained)
    assert main(["train", ID, "--out", str(trained.path)]) == 2
    assert f"--resume {trained.path}" in capfd.readouterr().err
    np.testing.assert_array_equal(weights(trained), before)


def test_evaluate_prints_means(trained, capfd):
    arguments = ["evaluate", str(trained.path), "--on", "g=5.0", "--seeds", "3", "--json"]
    assert main(arguments) == 0
    rows = json.loads(capfd.readouterr().out)
    assert [row["variant"] for row in rows] == ["", "g=5.0"]
    for row in rows:
        assert row["return"]["low"] <= row["return"]["mean"] <= row["return"]["high"]
        assert row["length"]["mean"] == 200
    assert main(["evaluate", ID, "--agent", "zero", "--seeds", "2"]) == 0
    assert ID in capfd.readouterr().out


def test_a_policy_for_another_environment_is_refused(trained, capfd):
    assert main(["evaluate", str(trained.path), "--env", "Swimmer-v5"]) == 2
    said = capfd.readouterr().err
    assert "observations of Swimmer-v5" in said
    assert all(shape in said for shape in ("(3,)", "(8,)"))


def test_a_policy_file_that_cannot_be_read_says_what_wrote_it(trained, tmp_path):
    folder = tmp_path / "policy"
    folder.mkdir()
    for name in ("config.json", "normalizer.json"):
        (folder / name).write_bytes((trained.path / name).read_bytes())
    with pytest.raises(OutputError, match="has no policy yet"):
        load_policy(folder)
    (folder / "policy.zip").write_bytes(b"not a zip")
    with pytest.raises(OutputError, match=r"written with .*stable-baselines3"):
        load_policy(folder)


@pytest.mark.slow
def test_without_the_extra_the_install_line_is_given():
    code = (
        "import sys\n"
        "for name in ('gymnasium', 'stable_baselines3'): sys.modules[name] = None\n"
        "from mjgranular.cli import main; sys.exit(main(['train', 'Pendulum-v1']))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "pip install 'mjgranular[train]'" in done.stderr
    assert "Traceback" not in done.stderr
    assert MissingExtraError.__doc__


def test_without_the_extra_policies_are_listed_and_nothing_is_written(tmp_path, monkeypatch, capfd):
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    assert main(["list", "policies", "Ant-v0/ppo-0"]) == 0
    assert "Ant-v0/ppo-0" in capfd.readouterr().out
    folder = tmp_path / "run"
    assert main(["train", "Pendulum-v1", "--out", str(folder)]) == 2
    assert "pip install 'mjgranular[train]'" in capfd.readouterr().err
    assert not folder.exists()


def test_policies_that_come_with_the_package_go_by_name(trained, tmp_path, monkeypatch, capfd):
    folder = tmp_path / "policies" / "Pendulum-v1" / "ppo-3"
    folder.mkdir(parents=True)
    for name in POLICY_FILES:
        (folder / name).write_bytes((trained.path / name).read_bytes())
    monkeypatch.setattr("mjgranular.learn.policies.SHIPPED", tmp_path / "policies")
    assert main(["list", "policies", "--json"]) == 0
    (row,) = json.loads(capfd.readouterr().out)
    assert (row["name"], row["environment"], row["seed"]) == ("Pendulum-v1/ppo-3", ID, 3)
    assert main(["list", "policies"]) == 0
    assert "Pendulum-v1/ppo-3" in capfd.readouterr().out
    np.testing.assert_array_equal(
        load_policy("Pendulum-v1/ppo-3").act(np.ones((2, 3)), np.zeros(2)),
        load_policy(trained.path).act(np.ones((2, 3)), np.zeros(2)),
    )
    assert main(["evaluate", "Pendulum-v1/ppo-3", "--seeds", "2"]) == 0
    capfd.readouterr()
    assert main(["render", "Pendulum-v1/ppo-3"]) == 2
    assert "add --out FILE" in capfd.readouterr().err
    with pytest.raises(UnknownNameError, match="there are: Pendulum-v1/ppo-3"):
        load_policy("Pendulum-v1/ppo-4")


@pytest.mark.slow
def test_a_training_run_is_filmed(tmp_path):
    settings = change(find_settings("Swimmer-v5"), ["num_envs=1", "total_steps=64", *QUICK["ppo"]])
    run = begin_run(tmp_path / "run", "Swimmer-v5", settings, seed=0)
    train(run)
    small = ["--seconds", "0.4", "--width", "64", "--height", "48"]
    assert main(["render", str(run.path), *small]) == 0
    assert (run.path / "policy.mp4").stat().st_size > 500
    assert main(["render", str(run.path), *small, "--out", str(tmp_path / "a.gif")]) == 2
    assert main(["render", str(run.path), *small]) == 2  # not twice


def test_variants_are_read_as_toml():
    assert parse_variant("medium=glass_beads, a=[1, 2],b=3,c=None") == {
        "medium": "glass_beads",
        "a": [1, 2],
        "b": 3,
        "c": None,
    }


def test_a_batch_trains_as_its_copy_does(tmp_path):
    settings = change(
        find_settings("mjgranular/ChainCrawl-v0", algorithm="ppo"),
        [
            *("num_envs=2", "total_steps=256", "checkpoint_every=128"),
            *("n_steps=32", "batch_size=64", "n_epochs=1"),
            *("environment.randomise={strength=[0.5, 2]}", "use_sde=true", "sde_sample_freq=4"),
        ],
    )
    whole = begin_run(tmp_path / "whole", "mjgranular/ChainCrawl-v0", settings, seed=1)
    train(whole)
    broken = begin_run(tmp_path / "broken", "mjgranular/ChainCrawl-v0", settings, seed=1)
    with pytest.raises(Killed):
        train(broken, report=kill_after(200))
    train(open_run(broken.path))
    np.testing.assert_array_equal(weights(broken), weights(whole))
