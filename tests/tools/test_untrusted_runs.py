"""Runs and policies that somebody else has made: data, unless more is asked for."""

import base64
import contextlib
import json
import os
import pickle
import shutil
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import PPO, SAC

from mjgranular._util import files
from mjgranular.cli import main
from mjgranular.errors import OutputError
from mjgranular.learn import change, checkpoint, find_settings
from mjgranular.learn.policies import POLICY_FILES, load_policy, shipped_policies
from mjgranular.learn.run import Run, begin_run, open_run
from mjgranular.learn.train import train

ID = "Pendulum-v1"
BALL = "<mujoco><worldbody><body><freejoint/><geom size='.1'/></body></worldbody></mujoco>"
QUICK = {
    "ppo": ("n_steps=64", "batch_size=64", "n_epochs=2"),
    "sac": ("learning_starts=100", "buffer_size=2000", "train_freq=32", "net=[16, 16]"),
}


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> Callable[[Path, str], Run]:
    """Puts a run of some hundred steps into a folder; one of each algorithm is trained."""
    runs: dict[str, Path] = {}

    def trained(folder: Path, algorithm: str) -> Run:
        if algorithm not in runs:
            runs[algorithm] = tmp_path_factory.mktemp(algorithm) / "run"
            few = ("num_envs=2", "checkpoint_every=256", "total_steps=512", *QUICK[algorithm])
            settings = change(find_settings(ID, algorithm=algorithm), few)
            train(begin_run(runs[algorithm], ID, settings, seed=0))
        shutil.copytree(runs[algorithm], folder)
        return open_run(folder)

    return trained


class Bomb:
    """Goes off when it is unpickled."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self):
        return os.mkdir, (str(self.marker),)


def copy(folder: Path, to: Path) -> None:
    """Copies what is in a checkpoint, but for its sums."""
    for file in folder.iterdir():
        if file.name != files.MANIFEST:
            (to / file.name).write_bytes(file.read_bytes())


def plant(file: Path, bomb: bytes) -> None:
    """Puts a bomb in place of every pickle in a file of Stable-Baselines3."""
    with zipfile.ZipFile(file) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    data = json.loads(entries["data"])
    pickles = [v for v in data.values() if isinstance(v, dict) and ":serialized:" in v]
    assert pickles
    for value in pickles:
        value[":serialized:"] = base64.b64encode(bomb).decode()
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in {**entries, "data": json.dumps(data).encode()}.items():
            archive.writestr(name, content)


@pytest.mark.parametrize("algorithm", ["ppo", pytest.param("sac", marks=pytest.mark.slow)])
def test_nothing_in_a_run_is_unpickled(trained, algorithm, tmp_path):
    run = trained(tmp_path / "run", algorithm)
    marker = tmp_path / "executed"
    bomb = pickle.dumps(Bomb(marker))
    for file in run.path.rglob("policy.zip"):
        plant(file, bomb)
    for folder in run.checkpoints():  # with sums that are right again
        files.write_folder(folder, lambda to, of=folder: copy(of, to))
    assert main(["evaluate", str(run.path), "--seeds", "2"]) == 0
    assert train(open_run(run.path).extended(640)).progress.steps == 640
    assert not marker.exists()
    older = run.path / "policy.zip"
    plant(older, bomb)
    with contextlib.suppress(Exception):  # so it would have gone off
        {"ppo": PPO, "sac": SAC}[algorithm].load(older, device="cpu")
    assert marker.exists()


def test_weights_that_hold_a_pickle_are_refused(trained, tmp_path):
    run = trained(tmp_path / "run", "ppo")
    marker = tmp_path / "executed"
    for file in (run.path / "policy.zip", run.checkpoints()[0] / "policy.zip"):
        with zipfile.ZipFile(file) as archive:
            entries = {name: archive.read(name) for name in archive.namelist()}
        with zipfile.ZipFile(file, "w") as archive:
            for name, content in {**entries, "policy.pth": pickle.dumps(Bomb(marker))}.items():
                archive.writestr(name, content)
        with pytest.raises(OutputError, match="holds more than numbers"):
            checkpoint.read_weights(file)
    assert not marker.exists()


def test_a_module_that_only_a_file_names_is_not_imported(trained, tmp_path, monkeypatch, capfd):
    code = "import gymnasium\n"
    code += "gymnasium.register('Strange-v0', 'gymnasium.envs.classic_control:PendulumEnv', "
    code += "max_episode_steps=5)\n"
    (tmp_path / "a_strange_module.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    run = trained(tmp_path / "run", "ppo")
    folder = tmp_path / "policy"
    folder.mkdir()
    for name in POLICY_FILES:
        (folder / name).write_bytes((run.path / name).read_bytes())
    file = folder / "config.json"
    env_id = "a_strange_module:Strange-v0"
    config = json.loads(file.read_text())
    file.write_text(json.dumps({**config, "environment": env_id}))
    evaluate_it = ["evaluate", str(folder), "--seeds", "2"]
    film = ["render", str(folder), "--out", str(tmp_path / "a.mp4")]
    for command in (evaluate_it, film, ["train", "--resume", str(folder)]):
        assert main(command) == 2
        assert "--trust" in capfd.readouterr().err
    with pytest.raises(OutputError, match="--trust"):
        train(open_run(folder))
    load_policy(folder)  # without an environment there is nothing to import
    assert "a_strange_module" not in sys.modules
    try:
        assert main([*evaluate_it, "--trust"]) == 0
        assert main(evaluate_it) == 0  # the user has imported it by now
        del sys.modules["a_strange_module"], gym.registry["Strange-v0"]
        assert main([*evaluate_it, "--env", env_id]) == 0  # he names it himself
        # These make an environment of whatever module their arguments name.
        for gate in ("GymV21Environment-v0", "gymnasium:GymV26Environment-v0"):
            file.write_text(json.dumps({**config, "environment": gate}))
            assert main(evaluate_it) == 2
            assert "--trust" in capfd.readouterr().err
    finally:
        sys.modules.pop("a_strange_module", None)
        gym.registry.pop("Strange-v0", None)


@pytest.mark.parametrize("name", ["mine", *shipped_policies()])
def test_policies_act_as_stable_baselines_has_them(trained, name, tmp_path):
    policy = load_policy(trained(tmp_path / "run", "ppo").path if name == "mine" else name)
    whole = PPO.load(policy.folder / "policy.zip", device="cpu")
    for what in ("observation_space", "action_space"):
        assert getattr(policy.model, what) == getattr(whole, what)
    seen = np.random.default_rng(0).normal(size=(9, *(whole.observation_space.shape or ()))) * 3
    np.testing.assert_array_equal(
        policy.model.predict(seen, deterministic=True)[0],
        whole.predict(seen, deterministic=True)[0],
    )


@pytest.mark.slow
def test_a_policy_that_squashes_its_actions_acts_as_stable_baselines_has_it(trained, tmp_path):
    policy = load_policy(trained(tmp_path / "run", "sac").path)
    whole = SAC.load(policy.folder / "policy.zip", device="cpu")
    seen = np.random.default_rng(0).normal(size=(9, 3))
    actions = policy.model.predict(seen, deterministic=True)[0]
    np.testing.assert_array_equal(actions, whole.predict(seen, deterministic=True)[0])
    assert policy.model.action_space.high[0] == 2.0


@pytest.mark.parametrize(
    "space",
    [
        gym.spaces.Box(np.array([-0.1, -np.inf]), np.array([1 / 3, np.inf]), dtype=np.float64),
        gym.spaces.Box(-0.4, 0.4, (2, 3), np.float32),
        gym.spaces.Box(0, 255, (2, 2), np.uint8),
        gym.spaces.Discrete(5, start=-2),
        gym.spaces.MultiDiscrete([3, 4]),
        gym.spaces.MultiBinary(4),
    ],
    ids=str,
)
def test_spaces_are_kept_as_they_are(space):
    described = json.loads(json.dumps(checkpoint.space_as_json(space)))
    assert checkpoint.space_from_json(described) == space


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("config.json", {"versions": None}, "versions must name packages"),
        ("config.json", {"environment": 7}, "environment"),
        ("config.json", {"environment": "\x1b[2J"}, "environment"),
        ("config.json", {"seed": "0"}, "seed must be an integer"),
        ("config.json", {"settings": []}, "settings must be an object"),
        ("config.json", {"command": "impact"}, "it is the result of mjgranular impact"),
        ("config.json", b"[]", "must be an object, not a list"),
        ("config.json", b'{"command": "train', "Unterminated string"),
        ("normalizer.json", b"", "is damaged"),
        ("policy.zip", b"", "is damaged"),
    ],
)
def test_a_damaged_run_is_told_of_in_one_sentence(name, change, message, tmp_path, capfd):
    shipped = shipped_policies()["Hopper-v0/ppo-0"].path
    for file in POLICY_FILES:
        (tmp_path / file).write_bytes((shipped / file).read_bytes())
    file = tmp_path / name
    if isinstance(change, dict):
        change = json.dumps({**json.loads(file.read_text()), **change}).encode()
    file.write_bytes(change)
    assert main(["evaluate", str(tmp_path)]) == 2
    said = capfd.readouterr().err
    assert message in " ".join(said.split())
    assert "Traceback" not in said


@pytest.mark.slow
@pytest.mark.parametrize("command", [["impact"], ["drop", "ball.xml"]])
def test_a_damaged_result_is_told_of_in_one_sentence(command, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    Path("ball.xml").write_text(BALL)
    folder = tmp_path / "run"
    quick = ["--timestep", "1e-4", "--duration", "0.02", "--json"]
    assert main([*command, *quick, "--out", str(folder)]) == 0
    file = folder / "trajectory.npz"
    whole = file.read_bytes()
    for content in (
        b"",
        b"PK",
        whole[:-100],
        whole[:100] + b"\0" * 50 + whole[150:],
        b"\x80\x04].",
    ):
        file.write_bytes(content)
        capfd.readouterr()
        assert main(["render", str(folder)]) == 2
        said = capfd.readouterr().err
        assert "holds no saved" in said
        assert "Traceback" not in said
    assert not (folder / "impact.mp4").exists()


@pytest.mark.parametrize("change", [{}, {"touchdown_time": None, "stopping_time": "0.1"}])
def test_a_summary_without_times_is_no_saved_impact(change, tmp_path, capfd):
    assert main(["impact", "--timestep", "1e-4", "--json", "--out", str(tmp_path)]) == 0
    (tmp_path / "summary.json").write_text(json.dumps(change))
    assert main(["render", str(tmp_path)]) == 2
    assert "holds no saved impact" in capfd.readouterr().err
