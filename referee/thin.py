"""Thins the first DEM runs, which were made before this folder, to at most 100 rows each.

    python referee/thin.py FOLDER      # with sphere_v1.0.csv and its like; writes data/seen

Forces are means since the row before: of drops from the change of momentum, m (dv/dt + g), which
is exact; of the push from the samples of the contacts' force.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from dem import GRAVITY, write_thin

RUNS = {
    "sphere_v1.0": 0.0692,
    "sphere_v3.0": 0.0692,
    "rod45_v1.0": 0.060476,
    "rod45_v3.0": 0.060476,
    "plate_push": None,
}
"""Masses of the bodies that were dropped [kg]."""

_ROWS = 100


def main(folder: Path, into: Path) -> None:
    """Thins all of them."""
    for name, mass in RUNS.items():
        file = folder / f"{name}.csv"
        columns = file.read_text().splitlines()[0].split(",")
        table = dict(zip(columns, np.loadtxt(file, delimiter=",", skiprows=1).T, strict=True))
        time, depth = table["time_s"], table["depth_m"]
        if mass is None:
            wet = depth >= 0
            rows = np.column_stack([time, depth, table["Fz_contact_N"]])[wet]
            write_thin(
                into / f"{name}.csv", ["time [s]", "depth [m]", "force [N]"], rows, ["force [N]"]
            )
            continue
        speed = -table["vz_com" if "vz_com" in table else "vz"]
        picks = np.unique(np.linspace(0, len(time) - 1, _ROWS).round().astype(int))
        t, v = time[picks], speed[picks]
        force = np.concatenate([[0.0], mass * (GRAVITY - np.diff(v) / np.diff(t))])
        names, rows = (
            ["time [s]", "depth [m]", "speed [m/s]", "force [N]"],
            [t, depth[picks], v, force],
        )
        if "pitch_deg" in table:
            names.append("pitch [deg]")
            rows.append(table["pitch_deg"][picks])
        write_thin(into / f"{name}.csv", names, np.column_stack(rows), [])


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(__file__).parent / "data" / "seen")
