"""Workers that die, nodes that go, engines that change: the table is the same to the last bit.

    python scripts/attacks/workers.py                  # everything, some minutes on two cores
    python scripts/attacks/workers.py same --drops 1000
    python scripts/attacks/workers.py kills --engine ray --count 20

`same` compares the files of `mjgranular sweep` from one process with those of Ray with 1, 2 and 4
workers. `kills` ends worker processes at random moments. `node` takes a machine away from a cluster
of two. `resume` breaks a sweep off and goes on with it on the other engine, again and again. `cost`
measures what Ray takes beside what processes take, `memory` what the process that collects
holds, `sampling` what a step in training does. Needs
the extras `ray` and `train`, and Linux.
"""

from __future__ import annotations

import argparse
import itertools
import logging
import multiprocessing
import os
import random
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any

from mjgranular.experiment import Impact, Study, StudyResult, journal_of, run_study
from mjgranular.experiment.table import write_csv
from mjgranular.pool import UNFINISHED, Journal, Workers, map_tasks
from mjgranular.pool.workers import Engine

# Cheap, so that everything ends within minutes: what is looked at is who works, not what comes out.
_LONG = Impact(speed=2.0, timestep=1e-4, scheme="explicit")  # some 4 ms a drop on a core
_SHORT = Impact(speed=2.0, timestep=2e-4, duration=0.02, scheme="explicit")  # 2 ms
_KILLED = 60  # drops of a run in which workers are killed


def study(drops: int, base: Impact) -> Study:
    """So many drops, drawn."""
    from mjgranular.experiment import Between

    return Study(base, {"speed": Between(1.0, 5.0), "angle": Between(0.6, 1.0)}, sample=drops)


def table(
    some: Study,
    on: Workers,
    folder: Path | None = None,
    progress: Callable[[int], None] | None = None,
) -> tuple[bytes, StudyResult]:
    """The bytes of the table, and the result."""
    journal = journal_of(some, folder)
    journal.begin()
    result = run_study(some, workers=on, journal=journal, progress=progress)
    with tempfile.TemporaryDirectory() as place:
        file = Path(place) / "table.csv"
        write_csv(file, result.columns(), result.rows)
        return file.read_bytes(), result


def children(engine: str) -> list[int]:
    """Worker processes that are at work."""
    if engine == "local":
        return [child.pid for child in multiprocessing.active_children() if child.pid]
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            if (entry / "cmdline").read_bytes().startswith(b"ray::_run"):
                found.append(int(entry.name))
        except OSError:
            continue
    return found


def same(drops: int) -> None:
    """Files of one process, of two, and of Ray with 1, 2 and 4 workers."""
    some = study(drops, _SHORT)
    expected, _ = table(some, Workers(count=1))
    ways: tuple[tuple[Engine, int], ...] = (("local", 2), ("ray", 1), ("ray", 2), ("ray", 4))
    for engine, workers in ways:
        found, _ = table(some, Workers(engine, workers))
        assert found == expected, (engine, workers)
        told = f"{drops} drops on {engine} with {workers} workers, {len(found)} bytes: equal"
        print(f"same: {told}", flush=True)


def kills(engine: Engine, count: int, draw: random.Random) -> None:
    """Ends workers at random moments of several runs, two in each.

    Three that hit one chunk are its end, and it would be right to say so.
    """
    some = study(_KILLED, _LONG)
    expected, _ = table(some, Workers(count=1))
    done = 0
    while done < count:
        moments = sorted(draw.sample(range(1, _KILLED - 10), 2))
        timers: list[threading.Timer] = []
        ended: list[int] = []

        def kill(ended: list[int] = ended) -> None:
            there = children(engine)
            if there:
                with suppress(OSError):
                    os.kill(draw.choice(there), signal.SIGKILL)
                    ended.append(1)

        def progress(
            finished: int,
            moments: list[int] = moments,
            timers: list[threading.Timer] = timers,
            kill: Callable[[], None] = kill,
        ) -> None:
            while moments and finished >= moments[0]:
                moments.pop(0)
                timers.append(threading.Timer(draw.uniform(0.0, 0.1), kill))
                timers[-1].start()

        with tempfile.TemporaryDirectory() as folder:
            found, result = table(some, Workers(engine, 2, 3), Path(folder), progress)
            for timer in timers:
                timer.join()
            lines = (Path(folder) / UNFINISHED).read_text().count("\n")
        assert result.failed == 0, [result.told(one) for one in result.failures]
        assert lines == 1 + _KILLED, "a row twice, or none"
        assert found == expected
        done += len(ended)
        print(f"kills: {done} of {count} workers of {engine} ended so far, table equal", flush=True)


def node() -> None:
    """A node of a cluster of two goes in the midst of the work."""
    import ray
    from ray.cluster_utils import Cluster

    some = study(60, _LONG)
    expected, _ = table(some, Workers(count=1))
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    other = cluster.add_node(num_cpus=1)
    gone = threading.Event()

    def progress(finished: int) -> None:
        if finished > 5 and not gone.is_set():
            gone.set()
            cluster.remove_node(other, allow_graceful=False)

    try:
        on = Workers("ray", chunk=5, address=cluster.address)
        found, result = table(some, on, progress=progress)
        assert gone.is_set()
        assert result.failed == 0
        assert found == expected
        print("node: one of two nodes was taken away, table equal", flush=True)
    finally:
        ray.shutdown()
        cluster.shutdown()


def resume(count: int, draw: random.Random) -> None:
    """Breaks sweeps off, and goes on with them on the other engine."""
    some = study(60, _SHORT)
    expected, _ = table(some, Workers(count=1))
    both: tuple[Engine, Engine] = ("local", "ray")
    engines = itertools.cycle(both)
    done, found = 0, b""
    while done < count:
        with tempfile.TemporaryDirectory() as folder:
            for engine in engines:
                before = journal_of(some, Path(folder))
                before.begin()
                stop = before.count + draw.randint(1, 20)
                before.close()

                def progress(finished: int, stop: int = stop) -> None:
                    if finished >= stop:
                        raise KeyboardInterrupt

                found, result = table(some, Workers(engine, 2, 3), Path(folder), progress)
                if not result.interrupted or result.finished == len(some):
                    break
                done += 1
            assert found == expected
        print(
            f"resume: {done} of {count} interruptions, each gone on from on the other engine",
            flush=True,
        )


def _nap(_shared: object, seconds: float) -> dict[str, float]:
    """A task of known length that takes no core: from when to when."""
    begin = time.monotonic()
    time.sleep(seconds)
    return {"begin": begin, "end": time.monotonic()}


def _work(_shared: object, loops: int) -> dict[str, float]:
    """A task that keeps a core busy: from when to when."""
    begin = time.monotonic()
    total = 0
    for k in range(loops):
        total += k
    return {"sum": total, "begin": begin, "end": time.monotonic()}


def cost(rounds: int = 3) -> None:
    """Time between the end of a chunk and the beginning of the next in its place, interleaved.

    And what twelve chunks of a second or so of work take, from the first beginning to the last end.
    """
    for seconds, count in ((1.0, 12), (0.1, 60), (0.0, 400)):
        least: dict[Engine, float] = {"local": 1e9, "ray": 1e9}
        for _ in range(rounds):
            for engine in least:
                least[engine] = min(least[engine], _between(engine, seconds, count))
        ratio = (seconds + least["ray"]) / (seconds + least["local"])
        each = ", ".join(f"{name} {1e3 * value:.2f} ms" for name, value in least.items())
        print(
            f"cost: between chunks of {seconds:g} s: {each}; ray over local {ratio:.4f}", flush=True
        )
    loops = _loops_of_a_second()
    ratios = []
    for _ in range(rounds):
        local, ray = _whole("local", loops, 12), _whole("ray", loops, 12)
        ratios.append(ray / local)
    each = ", ".join(f"{ratio:.3f}" for ratio in ratios)
    load = os.getloadavg()[0]
    print(f"cost: twelve chunks of work, ray over local: {each}; load {load:.1f}", flush=True)


def _loops_of_a_second() -> int:
    tried = 10**6
    least = min(each["end"] - each["begin"] for each in (_work(None, tried) for _ in range(5)))
    return int(tried / least)


def _whole(engine: Engine, loops: int, count: int) -> float:
    """From the first beginning to the last end of so many chunks of work [s]."""
    found = map_tasks(_work, [loops] * count, on=Workers(engine, 2, 1))
    rows = list(found.journal.results())
    return max(row["end"] for row in rows) - min(row["begin"] for row in rows)


def _between(engine: Engine, seconds: float, count: int) -> float:
    """Mean time that a place waits for its next chunk, of one task each [s].

    Of two places each chunk takes the one that has become free first, in whatever process: Ray has
    more of them than it uses at a time.
    """
    places = 2
    found = map_tasks(_nap, [seconds] * count, on=Workers(engine, places, 1))
    rows = list(found.journal.results())
    begins = sorted(row["begin"] for row in rows)[places:]
    ends = sorted(row["end"] for row in rows)
    return sum(b - e for b, e in zip(begins, ends, strict=False)) / len(begins)


def _row(_shared: object, number: int) -> dict[str, float]:
    """A task that costs nothing, and gives a row."""
    return {"number": number, "speed": 1.0 + number / 3.0, "depth": number / 7.0, "time": 0.1}


def memory(counts: tuple[int, ...] = (10**4, 10**5, 10**6)) -> None:
    """What the process that collects holds, with a row each of so many tasks, and after them."""
    engines: tuple[Engine, ...] = ("local", "ray")
    for engine in engines:
        for count in counts:
            with tempfile.TemporaryDirectory() as folder:
                before = _resident()
                most = [before]

                def progress(_done: int, most: list[int] = most) -> None:
                    most[0] = max(most[0], _resident())

                journal = Journal(Path(folder), {"rows": count}, count)
                journal.begin()
                on = Workers(engine, 2)
                found = map_tasks(_row, range(count), on=on, journal=journal, progress=progress)
                assert found.failed == 0
                rows = sum(1 for _ in found.journal.results())
                assert rows == count
                grown = (max(most[0], _resident()) - before) / 2**20
                journal.close()
            print(
                f"memory: {count:,} rows from {engine}: {before / 2**20:.0f} MiB before, "
                f"at most {grown:.1f} MiB more",
                flush=True,
            )


def _resident() -> int:
    """Memory of this process [bytes]."""
    pages = Path("/proc/self/statm").read_text().split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE")


def _sample(runner: Any) -> float:
    """Samples once on an env runner; the time of its processor that it took [s]."""
    begin = time.process_time()
    runner.sample()
    return time.process_time() - begin


def sampling(rounds: int = 8) -> None:
    """Processor time of a rollout of ChainCrawl, by Stable-Baselines3 and by RLlib, interleaved."""
    import torch
    from stable_baselines3.common.callbacks import BaseCallback

    from mjgranular.learn import find_settings, on_ray, train
    from mjgranular.learn.run import begin_run

    class Clock(BaseCallback):
        def _on_rollout_start(self) -> None:
            self.begin = time.process_time()

        def _on_rollout_end(self) -> None:
            least["Stable-Baselines3"] = min(
                least["Stable-Baselines3"], time.process_time() - self.begin
            )

        def _on_step(self) -> bool:
            return True

    least = {"Stable-Baselines3": 1e9, "RLlib": 1e9}
    env_id = "mjgranular/ChainCrawl-v0"
    settings = find_settings(env_id)
    torch.set_num_threads(1)  # as in a training
    with tempfile.TemporaryDirectory() as folder:
        run = begin_run(Path(folder) / "run", env_id, settings, seed=0)
        model = train.new_model(run, train.environments_of(run, threads=1))
        there = train.new_model(on_ray.here(run), train.environments_of(on_ray.here(run)))
        algorithm = on_ray.built(run, there, 1)
        group = algorithm.env_runner_group
        steps = settings.num_envs * settings.arguments["n_steps"]
        for _ in range(rounds):
            model.learn(steps, callback=Clock(), reset_num_timesteps=False)
            (found,) = group.foreach_env_runner(_sample, local_env_runner=False)
            least["RLlib"] = min(least["RLlib"], found)
        algorithm.stop()
    each = ", ".join(f"{name} {1e6 * value / steps:.0f} us" for name, value in least.items())
    ratio = least["RLlib"] / least["Stable-Baselines3"]
    print(f"sampling: a step of {env_id} by {each}; ratio {ratio:.2f}", flush=True)


@contextmanager
def _session() -> Iterator[None]:
    """One Ray for a check: its start is no part of any of them."""
    import ray

    ray.init(
        num_cpus=4,
        include_dashboard=False,
        logging_level=logging.ERROR,
        log_to_driver=False,
        address="local",
    )
    try:
        yield
    finally:
        ray.shutdown()


def main() -> None:
    """Runs what is named, or everything."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument(
        "what", nargs="*", help="same, kills, node, resume, cost, memory, sampling; default: all"
    )
    parser.add_argument("--engine", choices=("local", "ray"), help="for kills; default: both")
    parser.add_argument("--count", type=int, default=20, help="of kills and of interruptions")
    parser.add_argument("--drops", type=int, default=1000, help="for same")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    draw = random.Random(given.seed)
    engines = (given.engine,) if given.engine else ("local", "ray")
    checks: dict[str, Callable[[], object]] = {
        "same": lambda: same(given.drops),
        "kills": lambda: [kills(engine, given.count, draw) for engine in engines],
        "node": node,
        "resume": lambda: resume(given.count, draw),
        "cost": cost,
        "memory": memory,
        "sampling": sampling,
    }
    for name in given.what or checks:
        with nullcontext() if name == "node" else _session():
            checks[name]()


if __name__ == "__main__":
    main()
