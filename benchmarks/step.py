"""What a step of sand costs: `Sand.step` beside a bare Python loop of `mj_step`, in one run.

    python benchmarks/step.py [--save FILE] [--compare FILE]

The two loops take turns, so that a machine whose speed drifts slows both; the ratio of each turn
counts, and its median is quoted. Both begin every turn in the same state: the link at 10 m/s
and 45 degrees, its tip on the surface, so that sand acts from the first step on.
"""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import mujoco

import mjgranular
from mjgranular.experiment.provenance import versions
from mjgranular.models import Link

TIMESTEP = 1e-6
STEPS = 20_000
TURNS = 5


def bare(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Microseconds a step of `mj_step`."""
    step = mujoco.mj_step
    begin = time.perf_counter()
    for _ in range(STEPS):
        step(model, data)
    return (time.perf_counter() - begin) / STEPS * 1e6


def sandy(sand: mjgranular.Sand, data: mujoco.MjData) -> float:
    """Microseconds a step of `Sand.step`."""
    step = sand.step
    begin = time.perf_counter()
    for _ in range(STEPS):
        step(data)
    return (time.perf_counter() - begin) / STEPS * 1e6


def measure_steps() -> dict[str, Any]:
    """Cost of a step, for each law, over `TURNS` turns after one that is not counted."""
    model = Link().model(TIMESTEP)
    data = mujoco.MjData(model)
    key = model.key("impact").id
    rows = {}
    for law in ("link", "link_distributed"):
        sand = mjgranular.Sand(model, law=law)
        turns = []
        for _ in range(TURNS + 1):
            mujoco.mj_resetDataKeyframe(model, data, key)
            plain = bare(model, data)
            mujoco.mj_resetDataKeyframe(model, data, key)
            turns.append((plain, sandy(sand, data)))
        turns = turns[1:]
        ratios = [ours / plain for plain, ours in turns]
        rows[f"step, {law}"] = {
            "elements": len(sand.elements),
            "bare_us": statistics.median(plain for plain, _ in turns),
            "sand_us": statistics.median(ours for _, ours in turns),
            "ratio": statistics.median(ratios),
            "ratio_least": min(ratios),
            "ratio_most": max(ratios),
        }
    return rows


def measure_imports() -> dict[str, Any]:
    """Seconds of `import mjgranular` beyond `import mujoco`, and of the first step, cache warm."""
    code = (
        "import time; a = time.perf_counter(); import mujoco; b = time.perf_counter();"
        "import mjgranular; c = time.perf_counter();"
        "from mjgranular.models import Link; m = Link().model(1e-5); d = mujoco.MjData(m);"
        "e = time.perf_counter(); mjgranular.Sand(m).step(d); f = time.perf_counter();"
        "print(b - a, c - b, f - e)"
    )
    runs = []
    for _ in range(TURNS + 1):
        done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
        runs.append([float(word) for word in done.stdout.split()])
    mujoco_s, ours_s, first_s = (
        statistics.median(column) for column in zip(*runs[1:], strict=True)
    )
    return {"import": {"mujoco_s": mujoco_s, "mjgranular_s": ours_s, "first_step_s": first_s}}


def machine() -> str:
    """The processor, in words."""
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def main() -> None:
    """Measures, prints, saves and compares."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--save", type=Path, help="write the figures to this JSON file")
    parser.add_argument("--compare", type=Path, help="print them beside those of this file")
    options = parser.parse_args()
    figures = {**measure_steps(), **measure_imports()}
    before = json.loads(options.compare.read_text())["figures"] if options.compare else {}
    print(f"{machine()}, mujoco {mujoco.__version__}, mjgranular {mjgranular.__version__}")
    for name, row in figures.items():
        print(name)
        for key, value in row.items():
            old = before.get(name, {}).get(key)
            beside = "" if old is None else f"   before {old:.3f}"
            print(f"  {key:14s} {value:.3f}{beside}")
    if options.save:
        content = {"machine": machine(), "versions": versions(), "figures": figures}
        options.save.write_text(json.dumps(content, indent=2) + "\n")


if __name__ == "__main__":
    main()
