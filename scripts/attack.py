"""Attack the package with random models: all laws, surfaces, schemes, and memory.

    python scripts/attack.py --models 1000 --seed 0 --jobs 16
    python scripts/attack.py --only steps --seed 7 --case 123   # repeat one case

`steps` checks each step of both interfaces, `twins` that equivalent descriptions of a model move
alike.
Cases run in blocks, each in a process that may crash or hang. Each case is a line of JSON in the
file `--out`, written when it ends; a failure is printed with the command that repeats it. The last
output is a table of all checks. The exit status is 1 after a failure.
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
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
sys.path.append(str(HERE.parent))  # for a checkout that is not installed

from attacks.cases import Result  # noqa: E402

ATTACKS = ("steps", "twins")
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
    case = importlib.import_module(f"attacks.{name}").draw(options.seed, number, options)
    print("nothing to check in this case" if case is None else case.describe())
    faulthandler.enable()
    row = attempt(name, options, number)
    print(json.dumps(row, indent=2))
    return not row["failures"]


# In the main process


class Run:
    """Processes that run cases, and the report of all."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.options, self.lock = options, threading.Lock()
        self.children: set[subprocess.Popen[str]] = set()
        self.stopped = False
        self.cases: Counter[str] = Counter()
        self.failures: Counter[str] = Counter()
        options.out.parent.mkdir(parents=True, exist_ok=True)

    def block(self, name: str, numbers: range) -> None:
        """Run cases in a process; one that ends it is a failure, and the others need a new one."""
        while numbers and not self.stopped:
            with tempfile.TemporaryFile("w+", errors="replace") as log:
                for row in self.rows_of(name, numbers, log):
                    if "begun" not in row:
                        self.keep(row)
                        numbers = numbers[1:]
                if numbers and not self.stopped:
                    log.seek(0)
                    reason = log.read()[-2000:] or "the process ended without a message"
                    row = {"attack": name, "seed": self.options.seed, "case": numbers[0]}
                    self.keep({**row, "counts": {}, "failures": {"survives": reason}})
                    numbers = numbers[1:]

    def rows_of(self, name: str, numbers: range, log: Any) -> Iterator[dict[str, Any]]:
        """Run cases in a process, and yield its rows until it ends."""
        block = ["--first", numbers[0], "--models", len(numbers), "--limit", self.options.limit]
        words = [*arguments_of(name, self.options), *map(str, block)]
        command = [sys.executable, __file__, "--worker", *words]
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=log, text=True, start_new_session=True
        ) as child:
            self.children.add(child)
            if self.stopped:  # between the last case and this process
                child.kill()
            assert child.stdout is not None
            for line in child.stdout:
                yield json.loads(line)
        self.children.discard(child)

    def keep(self, row: dict[str, Any]) -> None:
        """Append a case to the file and to the table, and print its failures."""
        name, number = row["attack"], row["case"]
        words = [*arguments_of(name, self.options), "--case", str(number)]
        command = " ".join(["python scripts/attack.py", *words])
        with self.lock, self.options.out.open("a", encoding="utf-8") as file:
            print(json.dumps(row), file=file, flush=True)
            self.cases.update(f"{name}: {check}" for check in row["counts"] | row["failures"])
            for check, text in row["failures"].items():
                self.failures[f"{name}: {check}"] += 1
                print(f"FAILED {name} {number}, {check}: {text}\n  {command}", flush=True)

    def print_table(self) -> None:
        """Print the number of cases and of failures of each check."""
        print(f"\n{'check':36}{'cases':>8}{'failures':>10}")
        for check, count in sorted(self.cases.items()):
            print(f"{check:36}{count:8,}{self.failures[check]:10,}")
        print(f"\nreport: {self.options.out}")

    def all(self) -> int:
        """Run all requested cases; return the exit status."""
        last = self.options.first + self.options.models
        executor = ThreadPoolExecutor(self.options.jobs)
        try:
            futures = [
                executor.submit(self.block, name, range(first, min(first + BLOCK, last)))
                for first in range(self.options.first, last, BLOCK)
                for name in self.options.only
            ]
            for future in futures:
                future.result()
        finally:
            self.stopped = True
            for child in [*self.children]:
                child.kill()
            executor.shutdown(cancel_futures=True)
            self.print_table()
        return int(bool(self.failures))


def parse() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--only", nargs="+", choices=ATTACKS, default=ATTACKS)
    add("--models", type=int, default=1000, help="number of models")
    add("--seed", type=int, default=0)
    add("--first", type=int, default=0, help="number of the first case")
    add("--case", type=int, help="run this one in this process")
    add("--jobs", type=int, default=os.cpu_count(), help="number of processes")
    add("--limit", type=float, default=1800.0, help="seconds of a case, which may compile")
    add("--steps", type=int, default=STEPS, help="of each model")
    add("--kind", choices=("plain", "options", "hostile", "rest"), help="of events; default: all")
    add("--laws", nargs="+", help="default: all")
    add("--short", action="store_true", help="only some combinations of laws and surfaces")
    add("--out", type=Path, default=Path("runs/attack.jsonl"))
    add("--worker", action="store_true", help=argparse.SUPPRESS)
    return parser.parse_args()


def main() -> int:
    """Run all cases, or one."""
    options = parse()
    if options.worker:
        work(options)
        return 0
    if options.case is not None:
        return int(not repeat(options))
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    with contextlib.suppress(KeyboardInterrupt):
        return Run(options).all()
    return 130


if __name__ == "__main__":
    sys.exit(main())
