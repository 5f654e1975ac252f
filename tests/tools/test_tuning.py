"""A search over settings: what is tried, what is kept, the same on either engine."""

import csv
import json
import math
import re
import signal
import sys

import pytest
from scipy import stats

from mjgranular.cli import main
from mjgranular.errors import MissingExtraError
from mjgranular.learn import run_tuning as module
from mjgranular.learn.run import open_run
from mjgranular.learn.run_tuning import run_study
from mjgranular.learn.settings import change, find_settings, read_settings
from mjgranular.learn.space import at_ends, points_of, read_space
from mjgranular.learn.toml import settings_text, toml_text
from mjgranular.learn.trial import FAILED, FINISHED, STOPPED, run_trial
from mjgranular.learn.tuning import (
    BEST,
    TABLE,
    Tuning,
    begin_study,
    check_place,
    open_study,
)
from mjgranular.pool import UNFINISHED, Workers

ID = "Pendulum-v1"
TINY = ("num_envs=4", "n_steps=64", "batch_size=64", "n_epochs=2", "checkpoint_every=512")
SEARCH = ("gamma=0.9,0.97", "net=[8],[16,16]")


def settings(*changes):
    return change(find_settings(ID, algorithm="ppo"), [*TINY, "total_steps=1024", *changes])


def space(*words):
    return read_space(words, settings())


def rows_of(folder):
    """The table, without what the clock says."""
    with (folder / TABLE).open() as file:
        return [
            {name: value for name, value in row.items() if name != "seconds"}
            for row in csv.DictReader(file)
        ]


@pytest.mark.parametrize(
    ("word", "values"),
    [
        ("gamma=0.95,0.99", (0.95, 0.99)),
        ("gamma=0.9:1:3", (0.9, 0.95, 1.0)),
        ("learning_rate=1e-4:1e-2:3:log", (1e-4, 1e-3, 1e-2)),
        (
            "learning_rate=linear_1e-4:linear_1e-2:3:log",
            ("linear_0.0001", "linear_0.001", "linear_0.01"),
        ),
        ("learning_rate=linear_3e-4,1e-3", ("linear_3e-4", 1e-3)),
        ("n_epochs=2:10:5", (2, 4, 6, 8, 10)),
        ("batch_size=16:256:5:log", (16, 32, 64, 128, 256)),
        ("net=[64,64],[256]", ([64, 64], [256])),
        ("use_sde=true,false", (True, False)),
        ("activation=tanh,relu", ("tanh", "relu")),
        ("policy.log_std_init=-1:0:3", (-1.0, -0.5, 0.0)),
    ],
)
def test_values_in_words(word, values):
    (found,) = space(word).values()
    assert isinstance(found, tuple)
    assert found == values
    assert [type(one) for one in found] == [type(one) for one in values]


def test_points_are_spread_evenly_over_ranges():
    """Of a Latin hypercube each slice has one point; in factors where that is asked for."""
    drawn = points_of(
        space("learning_rate=1e-4:1e-2:log", "n_epochs=1:5", "gamma=0.9:1"), 100, seed=1
    )
    rates = [math.log10(point["learning_rate"]) for point in drawn]
    assert stats.kstest(rates, stats.uniform(-4, 2).cdf).statistic < 0.02
    assert sorted(int((rate + 4) / 2 * 100 - 1e-3) for rate in rates) == list(range(100))
    epochs = [point["n_epochs"] for point in drawn]
    assert {epochs.count(n) for n in range(1, 6)} == {20}
    assert points_of(space("gamma=0.9:1"), 5, 1) == points_of(space("gamma=0.9:1"), 5, 1)
    assert points_of(space("gamma=0.9:1"), 5, 1) != points_of(space("gamma=0.9:1"), 5, 2)


def test_an_end_is_told_where_there_is_one():
    where = space("gamma=0.9:1", "learning_rate=1e-4,1e-3,1e-2", "activation=tanh,relu")
    middle = {"gamma": 0.95, "learning_rate": 1e-3, "activation": "tanh"}
    assert at_ends(where, middle) == []
    assert at_ends(where, {**middle, "gamma": 0.999}) == ["gamma"]
    assert at_ends(where, {**middle, "learning_rate": 1e-2}) == ["learning_rate"]


@pytest.mark.parametrize(
    "changes",
    [
        (),
        ("net=[]", "policy.log_std_init=-0.7", "policy.squash_output=false"),
        ('environment.randomise={strength=[0.5,2.0], "a b"=1}', 'environment.medium=it\'s "x"'),
    ],
)
def test_settings_written_are_read_the_same(changes, tmp_path):
    expected = settings(*changes)
    file = tmp_path / "settings.toml"
    file.write_text(settings_text(expected, "of two\nlines"))
    assert read_settings(file).as_json() == expected.as_json()
    assert toml_text([True, 1, 1e-05, "é\x7f\n"]) == '[true, 1, 1e-05, "é\\u007f\\n"]'


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--search"], "needs what is searched over"),
        (["--search", "gamma"], "NAME=VALUE,VALUE"),
        (["--search", "gama=0.9,0.99"], "no setting of ppo .*did you mean gamma"),
        (["--search", "gamma=0.9:0.99"], "a grid needs values: say how many"),
        (["--search", "gamma=0.99:0.9", "--trials", "4"], "from its lower to its upper end"),
        (["--search", "gamma=0.9:0.9", "--trials", "4"], "from its lower to its upper end"),
        (["--search", "gamma=0:1:log", "--trials", "4"], "factors need a lower end above 0"),
        (["--search", "gamma=0.9,,0.99"], "an empty value"),
        (["--search", "gamma=0.9,0.9"], "the value 0.9 twice"),
        (["--search", "gamma=0.9"], "at least 2 points, not 1"),
        (["--search", "gamma=0.9,0.99", "gamma=0.9,0.99"], "searched over twice"),
        (["--search", "gamma=0.9:0.99:2.5"], "from 2 to 10000 values"),
        (["--search", "n_epochs=1:4:3"], "whole number"),
        (["--search", "n_epochs=1.5:4", "--trials", "3"], "whole number"),
        (["--search", "gamma=0.9,good"], "trial 1 of the search .*must be a number, not 'good'"),
        (["--search", "batch_size=64,100"], "trial 1 .*does not divide"),
        (["--search", "gamma=0.9:0.99", "--trials", "0"], "at least 2 points, not 0"),
        (["--search", "gamma=0.9:0.99:9999", "n_epochs=1,2"], "10000 are the most"),
        (["--search", "total_steps=1000,2000"], "is the budget of each trial"),
        (["--search", "seed=1,2"], "lest the luckiest be the best"),
        (["--search", "environment.g=9,10"], "returns in different environments"),
        (["--search", "gamma=0.9,0.99", "--set", "gamma=0.9"], "leave one of the two away"),
        (["--search", "gamma=0.9,0.99", "--scheduler", "asha"], "say --engine ray too"),
        (["--search", "gamma=0.9,0.99", "--env-runners", "2", "--engine", "ray"], "--workers"),
        (["--search", "gamma=0.9,0.99", "--workers", "0"], "at least 1 worker"),
        (["--search", "gamma=0.9,0.99", "--address", "auto"], "say --engine ray too"),
        (["--search", "policy.log_std=-1,0"], "trial 0 of .*unexpected keyword argument"),
        (
            ["--search", "gamma=0.9,0.99", "--engine", "ray", "--address", "127.0.0.1:1"],
            "nothing answers",
        ),
        (["--trials", "3"], "--trials is for --search"),
        (["--workers", "3"], "--workers is for --search; --env-runners"),
        (["--scheduler", "asha"], "--scheduler is for --search"),
    ],
)
def test_what_cannot_be_is_told_and_leaves_nothing(arguments, words, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    assert main(["train", ID, *arguments]) == 2
    error = " ".join(capfd.readouterr().err.split())
    assert error.startswith("error: ")
    assert re.search(words, error)
    assert [file for file in tmp_path.rglob("*") if file.name != "runs"] == []


def test_without_tune_the_install_line_is_given(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.delitem(sys.modules, "ray.tune", raising=False)
    with pytest.raises(MissingExtraError, match=r"mjgranular\[ray\]"):
        check_place(Tuning(ID, settings(), SEARCH), Workers("ray"))


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A search by the command line, in this process."""
    folder = tmp_path_factory.mktemp("done") / "study"
    given = ["--total-steps", "1024", "--set", *TINY, "--search", *SEARCH, "--workers", "1"]
    assert main(["train", ID, *given, "--out", str(folder)]) == 0
    return folder


def test_a_search_is_runs_a_table_and_the_best_settings(done, capfd):
    rows = rows_of(done)
    assert [(row["gamma"], row["net"]) for row in rows] == [
        ("0.9", "[8]"),
        ("0.9", "[16, 16]"),
        ("0.97", "[8]"),
        ("0.97", "[16, 16]"),
    ]
    assert {row["status"] for row in rows} == {FINISHED}
    best = max(rows, key=lambda row: float(row["return"]))
    found = read_settings(done / BEST)
    assert found.arguments["gamma"] == float(best["gamma"])
    run = open_run(done / f"trial-{best['trial']}")
    assert run.settings.as_json() == found.as_json()
    # The return is that of an evaluation of the run, by whoever makes it, with these seeds.
    capfd.readouterr()
    seeds = ["--seeds", "10", "--first-seed", "20000", "--json"]
    assert main(["evaluate", str(run.path), *seeds]) == 0
    (score,) = json.loads(capfd.readouterr().out)
    assert score["return"]["mean"] == float(best["return"])
    assert [score["return"][name] for name in ("low", "high")] == [
        float(best[name]) for name in ("low", "high")
    ]


def test_nothing_of_a_search_is_lost(done, capfd):
    before = (done / TABLE).read_bytes()
    assert main(["train", "--resume", str(done)]) == 0
    assert "nothing to do: all 4 trials" in capfd.readouterr().err
    assert main(["train", ID, "--search", *SEARCH, "--out", str(done)]) == 2
    assert "holds a search already" in " ".join(capfd.readouterr().err.split())
    assert main(["train", "--resume", str(done), "--trials", "9"]) == 2
    assert "leave --trials away" in " ".join(capfd.readouterr().err.split())
    assert main(["sweep", "--points", "2", "--out", str(done), "--overwrite"]) == 2
    assert "does not replace" in " ".join(capfd.readouterr().err.split())
    assert main(["evaluate", str(done)]) == 2
    assert "train --search" in capfd.readouterr().err
    assert (done / TABLE).read_bytes() == before


def stop_after(count):
    def progress(finished):
        if finished >= count:
            signal.raise_signal(signal.SIGINT)

    return progress


def test_an_interrupted_search_goes_on(done, tmp_path, monkeypatch, capfd):
    study = begin_study(tmp_path / "study", Tuning(ID, settings(), SEARCH))
    with study.opened():
        outcome = run_study(study, Workers(count=1), stop_after(2))
        assert outcome.stopped_by == signal.SIGINT
        assert study.journal.count == 2
    assert len(rows_of(study.path)) == 2
    tried = []

    def run(task):
        tried.append(task.folder)
        return run_trial(task)

    monkeypatch.setattr(module, "run_trial", run)
    assert main(["train", "--resume", str(study.path), "--workers", "1", "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["finished"]
    assert tried == ["trial-2", "trial-3"]
    assert rows_of(study.path) == rows_of(done)
    assert not (study.path / UNFINISHED).exists()


def test_trials_that_fail_are_told_and_the_others_are_there(tmp_path, monkeypatch, capfd):
    """A policy that loses reason is a row; what has another cause is tried again."""
    from mjgranular.errors import InputError

    def run(task):
        if task.folder == "trial-1":
            raise InputError("the disk is full of sand")
        row = run_trial(task)
        return {**row, "status": FAILED, "reason": "not finite"} if task.folder[-1] == "0" else row

    monkeypatch.setattr(module, "run_trial", run)
    folder = tmp_path / "study"
    given = ["--total-steps", "256", "--set", *TINY, "--search", "gamma=0.9:0.98:3"]
    assert main(["train", ID, *given, "--workers", "1", "--out", str(folder)]) == 2
    error = " ".join(capfd.readouterr().err.split())
    assert "trial 0: not finite" in error
    assert "trial 1: the disk is full of sand" in error
    assert [row["trial"] for row in rows_of(folder)] == ["0", "2"]
    monkeypatch.undo()
    assert main(["train", "--resume", str(folder), "--workers", "1"]) == 0
    assert [row["status"] for row in rows_of(folder)] == [FAILED, FINISHED, FINISHED]


@pytest.mark.parametrize(
    "changed",
    [{"search": "gamma"}, {"search": []}, {"seed": "x"}, {"trials": 0.5}, {"environment": 3}],
)
def test_a_damaged_search_is_told(changed, done, tmp_path, capfd):
    content = {**json.loads((done / "config.json").read_text()), **changed}
    (tmp_path / "config.json").write_text(json.dumps(content))
    assert main(["train", "--resume", str(tmp_path)]) == 2
    assert "config.json is damaged" in " ".join(capfd.readouterr().err.split())


def test_a_stranger_s_module_is_not_imported(done, tmp_path, capfd):
    content = json.loads((done / "config.json").read_text())
    content["environment"] = "module_of_a_stranger:X-v0"
    (tmp_path / "config.json").write_text(json.dumps(content))
    assert main(["train", "--resume", str(tmp_path)]) == 2
    assert "say --trust" in " ".join(capfd.readouterr().err.split())


@pytest.fixture(scope="module")
def session():
    ray = pytest.importorskip("ray", reason="the extra ray is not installed")
    pytest.importorskip("pandas", reason="the extra ray is not installed")
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


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of Ray's own ways
def test_on_ray_it_is_the_same_and_goes_on_there(session, done, tmp_path, capfd):
    study = begin_study(tmp_path / "study", Tuning(ID, settings(), SEARCH))
    with study.opened():
        outcome = run_study(study, Workers("ray", 1), stop_after(1))
    assert outcome.stopped_by == signal.SIGINT
    assert outcome.failures == {}
    assert 1 <= len(rows_of(study.path)) < 4
    study = open_study(study.path)
    with study.opened():
        outcome = run_study(study, Workers("ray", 2))
        assert outcome.stopped_by is None
    assert rows_of(study.path) == rows_of(done)
    assert (study.path / BEST).read_bytes() == (done / BEST).read_bytes()
    assert session.is_initialized()
    assert capfd.readouterr().out == ""


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_poor_trial_ends_early_also_beside_those_of_an_earlier_sitting(session, tmp_path):
    """With a rate of next to nothing a pole falls as it did; one that learned is known of."""
    few = ("num_envs=4", "n_steps=32", "n_epochs=5", "checkpoint_every=4096", "total_steps=4608")
    base = change(find_settings("CartPole-v1", algorithm="ppo"), [*few, "batch_size=64"])
    tuned = Tuning("CartPole-v1", base, ("learning_rate=3e-3,1e-8",), scheduler="asha")
    assert tuned.rungs == (512, 1536)
    study = begin_study(tmp_path / "study", tuned)
    with study.opened():
        outcome = run_study(study, Workers("ray", 1), stop_after(1))
    assert (outcome.stopped_by, study.journal.count) == (signal.SIGINT, 1)
    study = open_study(study.path)
    with study.opened():
        outcome = run_study(study, Workers("ray", 1))
        assert (outcome.stopped_by, outcome.failures) == (None, {})
        good, poor = study.rows()
        assert study.best() == good
    assert [steps // 256 for steps, _ in good["rungs"]] == [2, 6]
    assert (good["status"], poor["status"]) == (FINISHED, STOPPED)
    assert poor["steps"] < 4608
    assert poor["return"] is None
    assert poor["training_return"] < dict(map(tuple, good["rungs"]))[poor["steps"]]
    assert not (study.path / UNFINISHED).exists()
