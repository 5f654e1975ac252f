"""A run knows on what sand it was trained: where there is other sand now, the user is told."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

import mjgranular
from mjgranular import register_medium
from mjgranular.cli import main
from mjgranular.errors import GranularWarning, OutputError
from mjgranular.learn.policies import load_policy, shipped_policies
from mjgranular.learn.run import Run, begin_run, open_run
from mjgranular.learn.sands import Sands, changes, sands_made, sands_of
from mjgranular.learn.settings import Settings, change, find_settings
from mjgranular.learn.train import train
from mjgranular.medium import Medium, media

ID = "mjgranular/ChainSwim-v0"
QUICK = ("num_envs=2", "n_steps=32", "batch_size=64", "n_epochs=1", "checkpoint_every=64")
BODY = "<mujoco><worldbody><body><freejoint/><geom size='.1'/></body></worldbody></mujoco>"


def quick(environment: str = ID, *more: str) -> Settings:
    """Settings for few steps."""
    return change(find_settings(environment), [*QUICK, "total_steps=192", *more])


def of_before(medium: Medium) -> Medium:
    """The medium with the default law that it had once."""
    return replace(medium, default_law="rft3d")


class Stop(BaseException):
    """As good as a lost machine."""


def stop_after_the_first_checkpoint(done: int, _newest: float | None) -> None:
    if done > 96:
        raise Stop


@pytest.fixture(scope="module")
def whole_and_broken(tmp_path_factory):
    """Two runs, one of them broken off, that were begun when the default law was another."""
    now, folder = media["quikrete_medium"], tmp_path_factory.mktemp("runs")
    register_medium(of_before(now), replace=True)
    try:
        whole = begin_run(folder / "whole", ID, quick(), seed=1)
        train(whole)
        broken = begin_run(folder / "broken", ID, quick(), seed=1)
        with pytest.raises(Stop):
            train(broken, report=stop_after_the_first_checkpoint)
    finally:
        register_medium(now, replace=True)
    return whole, broken


def edited(run: Run, to: Path, **content: Any) -> Path:
    """A copy of the file of a run with other content."""
    to.mkdir()
    config = json.loads((run.path / "config.json").read_text())
    (to / "config.json").write_text(json.dumps({**config, **content}))
    for name in ("policy.zip", "normalizer.json", "curve.csv"):
        if (run.path / name).exists():
            (to / name).write_bytes((run.path / name).read_bytes())
    return to


def only(sands: Sands | None) -> dict[str, Any]:
    """The one sand that there is."""
    assert sands is not None
    (sand,) = sands
    return sand


def weights(run: Run) -> np.ndarray:
    parameters = load_policy(run.path).model.state_dict().values()
    return np.concatenate([p.numpy().ravel() for p in parameters])


def test_a_run_and_its_checkpoints_say_what_its_sand_is(whole_and_broken):
    whole, broken = whole_and_broken
    sand = only(open_run(whole.path).sand)
    assert (sand["medium"], sand["law"], sand["memory"]) == ("quikrete_medium", "rft3d", None)
    assert sand["surface"] == "plane height=0.0 slope=0.0 uphill=0.0"
    assert sand["constants"]["density"] == media["quikrete_medium"].density.value
    assert open_run(broken.checkpoints()[0]).sand == whole.sand


def test_an_evaluation_on_other_sand_says_so_once_and_how_it_is_had(whole_and_broken, capfd):
    path = str(whole_and_broken[0].path)
    command = ["evaluate", path, "--seeds", "2", "--json", "--on"]
    assert main([*command, "law=rft3d"]) == 0
    said = capfd.readouterr()
    assert said.err.count("warning") == 1
    for words in (path, "law rft3d (now rft3d_dynamic)"):
        assert words in said.err
    its_own, as_begun = (row["return"]["mean"] for row in json.loads(said.out))
    assert its_own != as_begun
    assert main(["evaluate", path, "--seeds", "2", "--env", "mjgranular/ChainSwim-v0"]) == 0
    assert "law rft3d (now rft3d_dynamic)" in capfd.readouterr().err


@pytest.mark.slow
def test_a_film_on_other_sand_says_so(whole_and_broken, tmp_path, capfd):
    path = str(whole_and_broken[0].path)
    small = ["--seconds", "0.1", "--width", "64", "--height", "48"]
    assert main(["render", path, *small, "--out", str(tmp_path / "a.mp4")]) == 0
    assert "law rft3d (now rft3d_dynamic)" in capfd.readouterr().err
    asked = ["--on", "law=rft3d", "--out", str(tmp_path / "b.mp4")]
    assert main(["render", path, *small, *asked]) == 0
    assert "warning" not in capfd.readouterr().err


def test_a_run_that_resumes_on_other_sand_says_so(whole_and_broken):
    _, broken = whole_and_broken
    with pytest.warns(GranularWarning, match=r"law rft3d \(now rft3d_dynamic\)"):
        train(open_run(broken.path))


def test_where_the_sand_is_unknown_there_is_no_warning(whole_and_broken, tmp_path, capfd):
    path = edited(whole_and_broken[0], tmp_path / "run", sand=None)
    assert main(["evaluate", str(path), "--seeds", "2"]) == 0
    assert "sand" not in capfd.readouterr().err
    assert changes(open_run(path).sand, sands_made(ID, {})) == ""


@pytest.mark.parametrize(
    "sand",
    [
        {},
        ["play_sand"],
        [{"medium": "play_sand", "law": "link", "surface": "plane", "memory": None}],
    ],
)
def test_what_is_no_sand_is_told_in_one_sentence(sand, whole_and_broken, tmp_path):
    path = edited(whole_and_broken[0], tmp_path / "run", sand=sand)
    with pytest.raises(OutputError, match="sand must be a list of tables"):
        open_run(path)


def test_a_policy_that_is_trained_without_sand_is_told_of(tmp_path, capfd):
    few = ["--total-steps", "64", "--set", "num_envs=1", "n_steps=64", "batch_size=64"]
    for name, warning in (
        ("Swimmer-v5", "Swimmer-v5 has no sand in its model: mjgranular/Swimmer-v0 has"),
        (
            "Reacher-v5",
            "Reacher-v5 has no sand in its model: what `mjgranular list envs` lists has",
        ),
        ("Pendulum-v1", ""),  # of which nobody can know
        ("mjgranular/LinkDrop-v0", ""),
    ):
        out = tmp_path / name.replace("/", "-")
        assert main(["train", name, *few, "--out", str(out)]) == 0
        said = capfd.readouterr().err
        assert warning in said
        assert said.count("warning") == bool(warning)
    assert open_run(tmp_path / "Swimmer-v5").sand == []
    assert open_run(tmp_path / "Pendulum-v1").sand is None


def test_all_sands_of_an_environment_are_noted():
    both = sands_made(ID, {"randomise": {"media": ["quikrete_medium", "glass_beads"]}})
    assert both is not None
    assert [sand["medium"] for sand in both] == ["quikrete_medium", "glass_beads"]
    spec = mujoco.MjSpec.from_string(BODY)
    mjgranular.add_sand(spec, surface="plane slope=0.1", memory="cell=0.02", law="rft3d scale=2")
    model = spec.compile()
    sand = only(sands_of(SimpleNamespace(unwrapped=SimpleNamespace(model=model))))
    assert (sand["surface"], sand["memory"]) == (
        "plane height=0.0 slope=0.1 uphill=0.0",
        "cell=0.02",
    )
    assert (sand["law"], sand["constants"]["scale"]) == ("rft3d", 2)
    bare = mujoco.MjModel.from_xml_string(BODY)
    own = SimpleNamespace(model=bare, bed=mjgranular.Sand(bare, law="rft3d"))
    held = only(sands_of(SimpleNamespace(unwrapped=own)))
    assert (held["medium"], held["law"]) == ("quikrete_medium", "rft3d")


def test_constants_that_have_changed_are_named():
    before, now = sands_made(ID, {}), media["quikrete_medium"]
    friction = replace(now.constants["rft3d"]["surface_friction"], value=0.5)
    constants = {"rft3d": {**now.constants["rft3d"], "surface_friction": friction}}
    register_medium(replace(now, constants=constants), replace=True)
    try:
        assert changes(before, sands_made(ID, {})) == "surface_friction 0.4 (now 0.5)"
    finally:
        register_medium(now, replace=True)


@pytest.mark.parametrize("name", shipped_policies())
def test_policies_that_come_with_the_package_act_on_the_sand_that_they_say(name):
    run = shipped_policies()[name]
    assert run.sand
    # Robots that follow commands were trained before the law had slip, and `evaluate` says so.
    older = ("", "slip 0 (now 2)") if "Velocity" in name else ("",)
    assert changes(run.sand, sands_made(run.environment, run.arguments)) in older
