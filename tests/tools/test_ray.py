"""The engine Ray: one cluster of two nodes for all, since its start takes seconds."""

import operator
import os
import signal
import sys
from pathlib import Path

import pytest

from mjgranular._util.result_folder import versions
from mjgranular.envs.rllib import register_env
from mjgranular.errors import InputError, MissingExtraError
from mjgranular.experiment import Impact, Study, journal_of, run_study
from mjgranular.pool import Workers, map_tasks, on_ray

ray = pytest.importorskip("ray", reason="the extra ray is not installed")

# Ray leaves files and sockets to the end of the process.
pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::ResourceWarning")]

STUDY = Study(
    Impact(timestep=1e-4, duration=0.05),
    {"speed": [1.0, 1.5, 2.0, 2.2, 2.5, 3.0], "law.eta_v": [18.0, 20.0, 23.0, 26.0]},
)


@pytest.fixture(scope="module", autouse=True)
def other_node():
    """The node of the two that this process is not on."""
    from ray.cluster_utils import Cluster

    each = {"num_cpus": 1, "include_dashboard": False, "object_store_memory": 80 * 2**20}
    cluster = Cluster(initialize_head=True, head_node_args=each)
    other = cluster.add_node(**each)
    ray.init(address=cluster.address, logging_level="ERROR", log_to_driver=False)
    yield lambda: cluster.remove_node(other, allow_graceful=False)
    ray.shutdown()
    cluster.shutdown()


def table(result, path):
    result.write_csv(path)
    return path.read_bytes()


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    return table(run_study(STUDY, workers=1), tmp_path_factory.mktemp("alone") / "table.csv")


def test_tables_are_the_same_to_the_bit(expected, tmp_path):
    result = run_study(STUDY, workers=Workers("ray", 2))
    assert table(result, tmp_path / "table.csv") == expected
    assert ray.is_initialized()  # the session that was there is left as it was


def test_without_ray_rllib_is_told_with_the_install_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray.tune.registry", None)
    with pytest.raises(MissingExtraError, match=r"mjgranular\[ray\]"):
        register_env("mjgranular/ChainSwim-v0")


def test_a_sweep_goes_on_on_the_other_engine(expected, tmp_path):
    def stop(done):
        if done >= 7 * len(stopped):
            raise KeyboardInterrupt

    stopped = []
    for engine in ("ray", "local"):
        stopped.append(engine)
        journal = journal_of(STUDY, tmp_path)
        journal.begin()
        on = Workers(engine, 1)
        result = run_study(STUDY, workers=on, journal=journal, progress=stop)
        assert result.interrupted
        assert 0 < result.finished < 24
        journal.close()
    journal = journal_of(STUDY, tmp_path)
    journal.begin()
    result = run_study(STUDY, workers=Workers("ray"), journal=journal)
    assert table(result, tmp_path / "table.csv") == expected
    journal.close()


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks at processes as Linux does")
def test_a_worker_that_is_killed_costs_nothing(tmp_path):
    """Each task writes its process's number, and waits; one of these processes is ended."""
    place = tmp_path / "worker"
    task = f"open({str(place)!r}, 'w').write(str(__import__('os').getpid())) * 0"
    tasks = [task, *(f"__import__('time').sleep(0.2) or {k}" for k in range(1, 12))]
    killed = []

    def kill(_done):
        if not killed:
            os.kill(int(place.read_text()), signal.SIGKILL)
            killed.append(1)

    on = Workers("ray", count=1)
    mapped = map_tasks(operator.call, tasks, shared=eval, on=on, progress=kill)
    assert list(mapped.journal.results()) == list(range(12))
    assert mapped.failures == []


def test_a_task_that_ends_its_worker_is_named_and_the_rest_is_there():
    tasks = ["0", "__import__('os')._exit(3)", "2"]
    on = Workers("ray", count=1)
    mapped = map_tasks(operator.call, tasks, shared=eval, on=on)
    assert list(mapped.journal.results()) == [0, 2]
    assert [(one.index, one.lost) for one in mapped.failures] == [(1, True)]
    assert "tried 3 times" in mapped.failures[0].reason


def test_other_versions_are_refused_before_anything_is_done(monkeypatch):
    monkeypatch.setattr(on_ray, "versions", lambda: {**versions(), "mujoco": "3.0"})
    with pytest.raises(InputError, match=r"mujoco .* there and 3.0 here"):
        map_tasks(operator.add, [1, 2], shared=1, on=Workers("ray"))


def test_a_node_that_goes_costs_nothing(expected, other_node, tmp_path):
    """The last of all: of the two nodes one is left."""
    gone = []

    def go(done):
        if done > 3 and not gone:
            gone.append(done)
            other_node()

    result = run_study(STUDY, workers=Workers("ray"), progress=go)
    assert gone
    assert result.failed == 0
    assert table(result, tmp_path / "table.csv") == expected
