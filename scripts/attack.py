"""Attack the package with random models, environments, damaged files, hostile text and kills.

    python scripts/attack.py --models 1000 --seed 0 --jobs 16      # random models, all laws
    python scripts/attack.py --only steps --seed 7 --case 123      # repeat one, in this process
    python scripts/attack.py --only steps --seed 7 --case 123 --shrink
    python scripts/attack.py --only input files kills --models 40  # the tests of tests/attack

Cases run in blocks, each in a process that may crash or hang. Each case is a line of JSON in the
file `--out`, written when it ends. The last output is a table of all checks, with the command that
repeats each failure. The exit status is 1 after a failure.
"""

from __future__ import annotations

import argparse
import contextlib
import faulthandler
import importlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections import Counter, defaultdict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
sys.path.append(str(HERE.parent))  # for a checkout that is not installed

from attacks.cases import Result  # noqa: E402

DRAWN = ("steps", "twins", "environments")
TESTS = {"input": "test_hostile_input.py", "files": "test_saved_files.py", "kills": "test_kills.py"}
"""Attacks in tests/attack, which pytest runs."""

BLOCK = 20  # cases of one process: MuJoCo does not free an `mjData` whose plugin raises an error
STEPS = 155  # of each model


def arguments_of(name: str, options: argparse.Namespace) -> list[str]:
    """Return the arguments that select an attack, apart from the numbers of its cases."""
    words = ["--only", name, "--seed", options.seed, "--steps", options.steps]
    words += ["--laws", *options.laws] if options.laws else []
    words += ["--kind", options.kind] if options.kind else []
    words += ["--short"] if options.short else []
    return [*map(str, words)]


# In the process of a case


def attempt(name: str, options: argparse.Namespace, number: int) -> dict[str, Any]:
    """Run one case in this process, and return its row of the report."""
    attack, began = importlib.import_module(f"attacks.{name}"), time.perf_counter()
    result = Result()
    try:
        case = attack.draw(options.seed, number, options)
        if case is not None:
            result = attack.run(case)
    except Exception:
        result.counts["errors"] += 1
        result.fail("errors", traceback.format_exc(limit=-3))
    return {
        "attack": name,
        "seed": options.seed,
        "case": number,
        "counts": result.counts,
        "failures": result.failures,
        "seconds": round(time.perf_counter() - began, 3),
    }


def work(options: argparse.Namespace) -> None:
    """Run the cases of a block, and print a row before and after each."""
    rows = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what others print goes to the log
    faulthandler.enable()
    for number in range(options.first, options.first + options.models):
        print(json.dumps({"begun": number}), file=rows, flush=True)
        faulthandler.dump_traceback_later(options.limit, exit=True)
        print(json.dumps(attempt(options.only[0], options, number)), file=rows, flush=True)
        faulthandler.cancel_dump_traceback_later()


def repeat(options: argparse.Namespace) -> bool:
    """Run one case and print all about it; return whether it passes."""
    name, number = options.only[0], options.case
    attack = importlib.import_module(f"attacks.{name}")
    case = attack.draw(options.seed, number, options)
    if case is None:
        print("nothing to check in this case")
        return True
    faulthandler.enable()
    row = attempt(name, options, number)
    if options.shrink and row["failures"]:
        from attacks.shrink import smaller

        check = next(iter(row["failures"]))

        def fails(part: Any) -> bool:
            with contextlib.suppress(Exception):  # mostly a model that MuJoCo cannot compile
                return check in attack.run(part).failures
            return False

        case = smaller(case, fails)
    print(case.describe())
    print(json.dumps(row, indent=2))
    return not row["failures"]


# In the main process


class Report:
    """Rows of all cases, in memory and in a file.

    Args:
        path: the file, to which a line is appended for each case.
        options: the command line.
    """

    def __init__(self, path: Path, options: argparse.Namespace) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self.path, self.options = path, options
        self.lock = threading.Lock()
        self.cases: dict[tuple[str, str], int] = defaultdict(int)
        self.checks: Counter[str] = Counter()
        self.failures: dict[tuple[str, str], list[tuple[str, str]]] = defaultdict(list)

    def keep(self, row: dict[str, Any], command: str) -> None:
        """Append a case to the file and the table, and print its failures."""
        with self.lock, self.path.open("a", encoding="utf-8") as file:
            print(json.dumps(row), file=file, flush=True)
            name = row["attack"]
            for check in row["counts"] | row["failures"]:
                self.cases[name, check] += row.get("cases", 1)
                self.checks[name] += row["counts"].get(check, 0)
            for check, text in row["failures"].items():
                self.failures[name, check].append((command, text))
                print(f"FAILED {name} {row['case']}, {check}: {text}\n  {command}", flush=True)

    def print_table(self) -> bool:
        """Print the table and the commands; return whether all cases passed."""
        print(f"\n{'check':36}{'cases':>8}{'failures':>10}")
        for name, check in sorted(self.cases):
            count, failed = self.cases[name, check], len(self.failures.get((name, check), ()))
            print(f"{f'{name}: {check}':36}{count:8,}{failed:10,}")
        for (name, check), found in sorted(self.failures.items()):
            print(f"\n{name}: {check}")
            for command, text in found:
                print(f"  {command}\n    {text.strip().splitlines()[-1][:200]}")
        made = ", ".join(f"{count:,} checks of {name}" for name, count in self.checks.items())
        print(f"\n{made or 'nothing was checked'}; report: {self.path}")
        return not self.failures


class Blocks:
    """Processes for the cases of random attacks.

    Args:
        report: receives the rows.
        options: the command line.
    """

    def __init__(self, report: Report, options: argparse.Namespace) -> None:
        self.report, self.options = report, options
        self.children: set[subprocess.Popen[str]] = set()
        self.stopped = False

    def run(self, name: str, numbers: range) -> None:
        """Run a block; a case that ends its process is a failure, and the others need a new one."""
        while numbers and not self.stopped:
            with tempfile.TemporaryFile("w+", errors="replace") as log:
                for row in self.rows_of(name, numbers, log):
                    if "begun" not in row:
                        self.keep(name, row)
                        numbers = numbers[1:]
                if self.stopped or not numbers:
                    return
                log.seek(0)
                self.keep(name, self.death(name, numbers[0], log.read()[-2000:]))
                numbers = numbers[1:]

    def keep(self, name: str, row: dict[str, Any]) -> None:
        """Put a row into the report, with the command that repeats it."""
        words = [*arguments_of(name, self.options), "--case", str(row["case"])]
        self.report.keep(row, " ".join(["python scripts/attack.py", *words]))

    def rows_of(self, name: str, numbers: range, log: Any, *more: str) -> Iterator[dict[str, Any]]:
        """Run cases in a process, and yield its rows until it ends."""
        block = ["--first", str(numbers[0]), "--models", str(len(numbers))]
        words = [*arguments_of(name, self.options), *block, "--limit", str(self.options.limit)]
        command = [sys.executable, __file__, "--worker", *words, *more]
        child = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=log, text=True, start_new_session=True
        )
        self.children.add(child)
        assert child.stdout is not None
        with child:
            for line in child.stdout:
                yield json.loads(line)
        self.children.discard(child)

    def death(self, name: str, number: int, log: str) -> dict[str, Any]:
        """Return the row of a case that ended its process, unless MuJoCo alone does so too."""
        row = {"attack": name, "seed": self.options.seed, "case": number, "counts": {}}
        if name == "steps":
            with tempfile.TemporaryFile("w+") as bare_log:
                numbers = range(number, number + 1)
                rows = [*self.rows_of(name, numbers, bare_log, "--bare")]
            if "begun" in rows[-1]:
                return {**row, "failures": {}, "note": f"MuJoCo alone crashes: {log}"}
        return {**row, "failures": {"survives": log or "the process ended without a message"}}

    def stop(self) -> None:
        """End all processes."""
        self.stopped = True
        for child in [*self.children]:
            child.kill()


def run_tests(name: str, options: argparse.Namespace, report: Report) -> None:
    """Run the tests of an attack with pytest, which prints the smallest failing example."""
    path = f"tests/attack/{TESTS[name]}"
    environment = {"ATTACK_SEED": str(options.seed), "ATTACK_CASES": str(options.models)}
    words = ["-q", "-m", "slow or not slow", "-p", "no:cacheprovider", path]
    command = [sys.executable, "-m", "pytest", *words]
    began = time.perf_counter()
    done = subprocess.run(command, cwd=HERE.parent, env=os.environ | environment, check=False)
    again = " ".join(f"{key}={value}" for key, value in environment.items())
    failures = {"pytest": f"exit status {done.returncode}"} if done.returncode else {}
    row = {"attack": name, "seed": options.seed, "case": 0, "counts": {"pytest": options.models}}
    row |= {"cases": options.models, "failures": failures}
    row |= {"seconds": round(time.perf_counter() - began, 3)}
    report.keep(row, f'{again} pytest -m "slow or not slow" {path}')


def run_all(options: argparse.Namespace) -> int:
    """Run the requested attacks; return the exit status."""
    report = Report(options.out, options)
    blocks, last = Blocks(report, options), options.first + options.models
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    executor = ThreadPoolExecutor(options.jobs)
    try:
        futures = [
            executor.submit(blocks.run, name, range(first, min(first + BLOCK, last)))
            for first in range(options.first, last, BLOCK)
            for name in options.only
            if name in DRAWN
        ]
        for future in futures:
            future.result()
        for name in options.only:
            if name in TESTS:
                run_tests(name, options, report)
    finally:
        blocks.stop()
        executor.shutdown(cancel_futures=True)
        passed = report.print_table()
    return int(not passed)


def parse() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--only", nargs="+", choices=[*DRAWN, *TESTS], default=["steps", "twins"])
    add("--models", type=int, default=1000, help="number of models, or of cases of other attacks")
    add("--seed", type=int, default=0)
    add("--first", type=int, default=0, help="number of the first case")
    add("--case", type=int, help="run this one in this process")
    add("--shrink", action="store_true", help="with --case: find a smaller model that fails")
    add("--jobs", type=int, default=os.cpu_count(), help="number of processes")
    add("--limit", type=float, default=600.0, help="seconds of a case; it may have to compile")
    add("--steps", type=int, default=STEPS, help="of each model")
    add("--kind", choices=("plain", "options", "hostile", "rest"), help="of events; default: all")
    add("--laws", nargs="+", help="default: all")
    add("--short", action="store_true", help="only some combinations of laws and surfaces")
    add("--out", type=Path, default=Path("runs/attack.jsonl"))
    add("--bare", action="store_true", help=argparse.SUPPRESS)
    add("--worker", action="store_true", help=argparse.SUPPRESS)
    return parser.parse_args()


def main() -> int:
    """Run all cases, or one."""
    options = parse()
    options.out = options.out.resolve()
    if options.worker:
        work(options)
        return 0
    if options.case is not None:
        return int(not repeat(options))
    with contextlib.suppress(KeyboardInterrupt):
        return run_all(options)
    return 130


if __name__ == "__main__":
    sys.exit(main())
