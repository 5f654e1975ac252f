"""Attacks the package: random models through both doors, files, kills, media, MJCF.

    python scripts/attack.py                                  # 3,000 models, 400,000 steps
    python scripts/attack.py --seed 7 --models 200 --only models
    python scripts/attack.py --reproduce 7:123                # one model again, by itself

What is found is told in a table and kept in a folder: `report.json`, and for the first cases of
each kind the model and a script. It ends with 1 if anything is against what is promised.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

from attacks import changes, models  # noqa: E402
from attacks.crew import Crew  # noqa: E402
from attacks.draw import draw  # noqa: E402
from attacks.finding import as_dict, failure  # noqa: E402
from attacks.report import Tally, show, write, write_case  # noqa: E402
from attacks.walk import Walk  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn  # noqa: E402

STEPS = 155  # of a model: with those that end early, 3,000 make 400,000
OTHERS = {"files": 200, "kills": 10, "media": 200, "mjcf": 200}
"""Modules with `run(seed, count)` that give failures in words, and how much they do by default."""


def attack_models(options: argparse.Namespace, tally: Tally, progress: Progress) -> None:
    """Walks random models, in processes that may crash."""
    numbers = range(options.first, options.first + options.models)
    with Crew(options.jobs) as crew:
        task = progress.add_task("compiling", total=len(models.PROGRAMS))
        for _ in crew.warm(models.PROGRAMS):
            progress.advance(task)
        task = progress.add_task("models", total=len(numbers))
        found = crew.walk(options.seed, numbers, options.steps, models.PROGRAMS, options.kind)
        for row in found:
            tally.add(row)
            progress.update(task, advance=1, description=f"models, {len(tally.failures)} failures")


def attack_others(options: argparse.Namespace, tally: Tally, progress: Progress) -> None:
    """Runs what there is beside models."""
    for name, count in OTHERS.items():
        if name not in options.only or not (HERE / "attacks" / f"{name}.py").exists():
            continue
        task = progress.add_task(name, total=1)
        asked = count if options.count is None else options.count
        tally.others[name] = importlib.import_module(f"attacks.{name}").run(options.seed, asked)
        progress.advance(task)


def reproduce(options: argparse.Namespace, console: Console) -> int:
    """Walks one model in this process, and tells all about it."""
    seed, number = (int(word) for word in options.reproduce.split(":"))
    drawn = draw(seed, number, options.steps, models.PROGRAMS, options.kind)
    console.print(f"{drawn.kind}: Sand(model, {drawn.model.sand})", markup=False)
    for step, lines in sorted(drawn.plan.events.items()):
        console.print(f"{step:4d}  {'; '.join(lines)}", markup=False)
    walked = Walk(seed, number, options.steps, drawn)
    # Before it is walked: it may crash.
    everything = failure(seed, number, "all of its steps", step=options.steps - 1, kind="case")
    folder = write_case(everything, options.out, options.steps, models.PROGRAMS, options.kind)
    console.print(f"model and script: {folder}")
    import faulthandler

    faulthandler.enable()
    walked.run()
    walked.ask_twins()
    for finding in walked.findings:
        console.print_json(data=as_dict(finding))
    console.print(dict(walked.counts))
    return int(any(finding.failed for finding in walked.findings))


def parse() -> argparse.Namespace:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--models", type=int, default=3000)
    parser.add_argument("--first", type=int, default=0, help="number of the first model")
    parser.add_argument("--steps", type=int, default=STEPS, help="of each model")
    parser.add_argument("--kind", choices=changes.KINDS, help="of runs; default: all kinds")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--only", nargs="+", default=["models", *OTHERS])
    parser.add_argument("--count", type=int, help="of files, kills, media, MJCF each")
    parser.add_argument("--out", type=Path, default=Path("runs/attack"))
    parser.add_argument("--reproduce", metavar="SEED:NUMBER")
    return parser.parse_args()


def main() -> int:
    """Runs what is asked for."""
    options, console = parse(), Console()
    options.out = options.out.resolve()
    if options.reproduce:
        return reproduce(options, console)
    tally, started = Tally(), time.perf_counter()
    columns = ("{task.description}", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    try:
        with Progress(*columns, console=console) as progress:
            if "models" in options.only:
                attack_models(options, tally, progress)
            attack_others(options, tally, progress)
    except KeyboardInterrupt:
        console.print("interrupted: what there is so far")
    show(tally, console)
    write(
        tally,
        options.out,
        steps=options.steps,
        programs=models.PROGRAMS,
        kind=options.kind,
        seed=options.seed,
        first=options.first,
        wall_seconds=round(time.perf_counter() - started, 1),
    )
    console.print(f"report: {options.out / 'report.json'}")
    if tally.failures:
        kind = f" --kind {options.kind}" if options.kind else ""
        console.print(f"again: python scripts/attack.py --reproduce SEED:NUMBER{kind}")
    return int(tally.failed)


if __name__ == "__main__":
    sys.exit(main())
