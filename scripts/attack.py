"""Attack the package: random models through both interfaces, damaged files, kills, media, MJCF.

    python scripts/attack.py                                # 3,000 models and all other attacks
    python scripts/attack.py --only models --seed 7 --models 200 --laws rft3d rft2d
    python scripts/attack.py --only models --seed 7 --case 123     # one case, in this process

Other cases run in worker processes, which may crash or hang. Each finding is printed with the
command that repeats its case; the file `--out` gets a line of JSON for each case. The exit status
is 1 after a failure.
"""

from __future__ import annotations

import argparse
import faulthandler
import importlib
import json
import os
import sys
import tempfile
from collections import Counter, defaultdict
from dataclasses import asdict
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))

from attacks import changes, models, worker
from rich.console import Console
from rich.progress import track

STEPS = 155  # per model: with those that end early, 3,000 models make 400,000
MODELS = 3000
COUNTS = {"files": 200, "kills": 16, "workers": 8, "media": 200, "mjcf": 200}
"""Attacks besides models, and their default number of cases."""


def load(name: str) -> Any:
    """Import an attack."""
    return importlib.import_module(f"attacks.{'walk' if name == 'models' else name}")


def again(name: str, number: int, options: argparse.Namespace) -> str:
    """Return the command that repeats one case."""
    words = ["python scripts/attack.py --only", name, "--seed", options.seed, "--case", number]
    words += ["--steps", options.steps] if options.steps != STEPS else []
    words += ["--kind", options.kind] if options.kind else []
    words += ["--laws", *options.laws] if options.laws else []
    words += ["--commands", *options.commands] if options.commands else []
    return " ".join(map(str, words))


def run_all(name: str, options: argparse.Namespace, console: Console) -> bool:
    """Run one attack in workers and print findings; return whether one breaks a promise."""
    attack = load(name)
    count = options.models if name == "models" else options.count or COUNTS[name]
    cases = attack.cases(options, range(options.first, options.first + count))
    counts: Counter[str] = Counter()
    kinds: dict[str, list[worker.Finding]] = defaultdict(list)
    megabytes = 0.0
    results = worker.run(attack.__name__, cases, options.jobs)
    with options.out.open("a", encoding="utf-8") as out:
        for index, result in track(results, name, len(cases), console=console):
            number = options.first + index
            row = {"attack": name, "seed": options.seed, "case": number, **asdict(result)}
            print(json.dumps(row), file=out, flush=True)
            counts.update(result.counts)
            megabytes = max(megabytes, result.megabytes)
            for found in result.findings:
                kinds[f"{found.kind}{'' if found.failed else ' (no failure)'}"].append(found)
            failures = [found for found in result.findings if found.failed]
            for found in failures:
                place = f"{name} {number} {found.where}".strip()
                text = f"FOUND {place}: {found.kind}: {found.text}"
                console.print(text, markup=False, soft_wrap=True)
            if failures:
                console.print(f"  again: {again(name, number, options)}", soft_wrap=True)
    for what, total in sorted(counts.items()):
        console.print(f"  {what}: {total:,}", markup=False)
    for kind, found in sorted(kinds.items()):
        worst = max(found, key=lambda each: each.value)
        console.print(f"  {kind}: {len(found)} cases, worst {worst.text[:200]}", markup=False)
    console.print(f"{name}: {len(cases)} cases, at most {megabytes:.0f} MB in a process")
    return any(found.failed for each in kinds.values() for found in each)


def run_one(name: str, options: argparse.Namespace, console: Console) -> bool:
    """Run one case in this process, and print all about it."""
    attack = load(name)
    (case,) = attack.cases(options, range(options.case, options.case + 1))
    describe = getattr(attack, "describe", json.dumps)
    console.print(describe(case), markup=False, highlight=False, soft_wrap=True)
    faulthandler.enable()
    with tempfile.TemporaryDirectory(prefix="attack-") as folder:
        os.chdir(folder)
        if hasattr(attack, "prepare"):
            attack.prepare()
        result = worker.attempt_here(attack, case, lambda _text: None)
    console.print_json(data=asdict(result))
    return any(found.failed for found in result.findings)


def parse() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    everything = ["models", *COUNTS]
    parser.add_argument("--only", nargs="+", choices=everything, default=everything)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--models", type=int, default=MODELS, help="number of models")
    parser.add_argument("--count", type=int, help="number of files, kills, media, MJCF each")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--case", type=int, help="run this one in this process")
    parser.add_argument("--steps", type=int, default=STEPS, help="of each model")
    parser.add_argument("--kind", choices=changes.KINDS, help="of events; default: all kinds")
    parser.add_argument("--laws", nargs="+", choices=list(models.LAWS), help="default: all laws")
    parser.add_argument("--commands", nargs="+", help="commands to kill; default: all")
    parser.add_argument("--jobs", type=int, default=2, help="worker processes")
    parser.add_argument("--out", type=Path, default=Path("runs/attack.jsonl"))
    return parser.parse_args()


def main() -> int:
    """Run the requested attacks."""
    options, console = parse(), Console()
    options.out = options.out.resolve()
    options.out.parent.mkdir(parents=True, exist_ok=True)
    run, failed = run_all if options.case is None else run_one, False
    try:
        for name in options.only:
            failed |= run(name, options, console)
    except KeyboardInterrupt:
        console.print("interrupted")
        return 130
    console.print(f"results: {options.out}")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
