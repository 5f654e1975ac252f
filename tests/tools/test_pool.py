"""Tasks on workers: order, failures, workers that die, runs that go on. On Ray: `test_ray.py`."""

import json
import math
import multiprocessing
import operator
import os
import signal
import socket
from typing import Any

import pytest

from mjgranular._util.result_folder import mismatch, versions
from mjgranular.cli import main
from mjgranular.errors import InputError, MissingExtraError, OutputError, UnknownNameError
from mjgranular.pool import UNFINISHED, Journal, Workers, map_tasks
from mjgranular.pool import tasks as handing
from mjgranular.pool.on_ray import RayPool, _run
from mjgranular.pool.workers import Answer, ThisProcess, WorkerLostError

HERE = Workers(count=1)


def results(mapped):
    return list(mapped.journal.results())


def test_a_task_that_raises_is_told_and_the_others_are_there():
    mapped = map_tasks(operator.truediv, [1.0, 0.0, 2.0], shared=1.0, on=HERE)
    assert results(mapped) == [1.0, 0.5]
    assert [(one.index, one.lost) for one in mapped.failures] == [(1, False)]
    assert mapped.failures[0].reason == "ZeroDivisionError: float division by zero"
    mapped = map_tasks(operator.call, ["0", "__import__('sys').exit(3)", "2"], shared=eval, on=HERE)
    assert results(mapped) == [0, 2]
    assert mapped.failures[0].reason == "SystemExit: 3"


def test_a_result_may_be_nan():
    first, second = results(map_tasks(operator.mul, [math.nan, math.inf], shared=1.0, on=HERE))
    assert math.isnan(first)
    assert second == math.inf


def test_an_interruption_keeps_what_is_done_and_a_journal_goes_on(tmp_path):
    def stop(done):
        if done == 3:
            raise KeyboardInterrupt

    tasks = list(range(10))
    journal = Journal(tmp_path, {"of": "sums"}, 10)
    journal.begin()
    mapped = map_tasks(operator.add, tasks, shared=1, on=HERE, journal=journal, progress=stop)
    assert (mapped.interrupted, mapped.stopped_by) == (True, signal.SIGINT)
    assert results(mapped) == [1, 2, 3]
    journal.close()
    again = Journal(tmp_path, {"of": "sums"}, 10)
    assert again.fault() is None
    again.begin()
    mapped = map_tasks(operator.add, tasks, shared=2, on=HERE, journal=again)
    assert results(mapped) == [1, 2, 3, *range(5, 12)]  # the first three are not computed again


def test_an_interrupt_between_writing_and_counting_loses_no_result(tmp_path, monkeypatch):
    journal = Journal(tmp_path, {}, 3)
    journal.begin()

    def keep(index, row):
        number = journal.count
        Journal.keep(journal, index, row)
        journal.count = number
        raise KeyboardInterrupt

    monkeypatch.setattr(journal, "keep", keep)
    mapped = map_tasks(operator.add, [0, 1, 2], shared=1, on=HERE, journal=journal)
    assert (mapped.interrupted, journal.count) == (True, 1)
    assert results(mapped) == [1]


def test_a_journal_of_something_else_says_what_differs(tmp_path):
    journal = Journal(tmp_path, {"of": "sums", "size": 3}, 3)
    journal.keep(0, {"x": 1})
    journal.close()
    assert Journal(tmp_path, {"of": "sums", "size": 3}, 3).fault() is None
    assert "another size" in str(Journal(tmp_path, {"of": "sums", "size": 4}, 4).fault())
    text = (tmp_path / UNFINISHED).read_text()
    (tmp_path / UNFINISHED).write_text(text.replace(f'"{versions()["mujoco"]}"', '"1.0"'))
    assert "version of mujoco" in str(Journal(tmp_path, {"of": "sums", "size": 3}, 3).fault())


@pytest.mark.parametrize(
    "line",
    [
        '{"index": 3, "row": {"x": 1}}',
        '{"index": 1}',
        "[]",
        "x" * 2_000_000,
    ],
)
def test_a_damaged_journal_is_not_gone_on_from(line, tmp_path):
    def journal():
        return Journal(tmp_path, {"of": "sums"}, 3)

    first = journal()
    first.keep(0, {"x": 1})
    first.close()
    with (tmp_path / UNFINISHED).open("a") as file:
        file.write(f"{line}\n")
    assert journal().fault() == "it is damaged"


def test_results_lie_on_the_disk_and_not_in_memory():
    """A hundred thousand rows of 1 kB are 100 MB; what is kept of each is where it lies."""
    import tracemalloc

    journal = Journal(None, {}, 20_000)
    journal.begin()
    tracemalloc.start()
    for index in range(20_000):
        journal.keep(index, {"text": "x" * 1000})
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 2e6
    assert sum(1 for _ in journal.results()) == 20_000
    journal.close()


def test_mistakes():
    with pytest.raises(UnknownNameError, match="no engine 'dask'"):
        Workers("dask")
    with pytest.raises(InputError, match="at least 1 worker"):
        Workers(count=0)
    with pytest.raises(InputError, match="say --engine ray too"):
        Workers(address="auto")


def test_what_cannot_be_written_is_told(tmp_path):
    journal = Journal(tmp_path / "gone", {}, 2)
    with pytest.raises(OutputError, match="cannot write"):
        journal.keep(0, {"x": 1})


def test_a_journal_on_a_full_disk_can_be_closed(tmp_path):
    resource = pytest.importorskip("resource", reason="limits of a process are those of POSIX")
    journal = Journal(tmp_path, {}, 1)
    journal.begin()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, before[1]))
    try:
        with pytest.raises(OutputError, match="cannot write"):
            journal.keep(0, {"x": 1})
        journal.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


# Processes


@pytest.mark.slow
def test_a_worker_that_dies_costs_nothing_but_a_task_that_kills_does():
    ended = []

    def kill(done):
        busy = multiprocessing.active_children()
        if not ended and done == 2 and busy:
            os.kill(busy[0].pid, signal.SIGKILL)
            ended.append(1)

    tasks = list(range(8))
    mapped = map_tasks(operator.add, tasks, shared=1, on=Workers(count=2), progress=kill)
    assert ended
    assert results(mapped) == list(range(1, 9))
    assert mapped.failures == []
    # A task is text, and what all share evaluates it: functions of tests are not found elsewhere.
    tasks = ["0", "1", "__import__('os')._exit(3)", "3"]
    mapped = map_tasks(operator.call, tasks, shared=eval, on=Workers(count=2))
    assert [(one.index, one.lost) for one in mapped.failures] == [(2, True)]
    assert "ended" in mapped.failures[0].reason
    assert "tried 3 times" in mapped.failures[0].reason
    assert results(mapped) == [0, 1, 3]
    assert multiprocessing.active_children() == []


def test_three_workers_that_die_are_the_end_of_a_task(monkeypatch):
    class Dying(ThisProcess):
        def result(self, future) -> Answer:
            raise WorkerLostError("it died")

    monkeypatch.setattr(handing, "ThisProcess", Dying)
    mapped = map_tasks(operator.add, [1, 2, 3], shared=1, on=HERE)
    assert mapped.lost == 3
    assert mapped.failures[0].reason == "it died; tried 3 times"


# Ray, as far as it needs none


def test_without_ray_the_install_line_is_given(monkeypatch, capfd):
    monkeypatch.setitem(__import__("sys").modules, "ray", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'mjgranular\[ray\]'"):
        RayPool(operator.add, 1, Workers("ray"))
    assert main(["sweep", "--vary", "speed=1,2", "--engine", "ray"]) == 2
    assert "mjgranular[ray]" in capfd.readouterr().err


@pytest.mark.parametrize("address", ["somewhere", "ray://host:10001", "host:", ":1", "host:99999"])
def test_an_address_that_is_none(address, capfd):
    pytest.importorskip("ray")
    assert main(["sweep", "--vary", "speed=1,2", "--engine", "ray", "--address", address]) == 2
    assert "HOST:PORT of its head" in capfd.readouterr().err


def test_an_address_where_nobody_listens_is_an_error(capfd):
    pytest.importorskip("ray")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
        assert main(["sweep", "--vary", "speed=1,2", "--engine", "ray", "--address", address]) == 2
    assert f"nothing answers at {address}" in capfd.readouterr().err


def test_a_worker_of_another_version_refuses_and_names_both():
    here = versions()
    assert mismatch(here, here) is None
    refusal = _run((operator.add, 1, {**here, "mjgranular": "0.1.0"}), 1)
    assert f"mjgranular {here['mjgranular']} there and 0.1.0 here" in refusal
    refusal = _run((operator.add, 1, {**here, "mujoco": "3.0"}), 1)
    assert f"mujoco {here['mujoco']} there and 3.0 here" in refusal
    done: Any = _run((operator.add, 1, here), 1)
    assert json.dumps(done.result) == "2"
