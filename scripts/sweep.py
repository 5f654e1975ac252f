"""Depth and stopping time against the diameter of the link: a custom sweep.

python scripts/sweep.py
"""

from dataclasses import replace

from mjgranular.experiment import Impact, run_impact


def main() -> None:
    """Drop links like the paper's, of five diameters, at 2 m/s."""
    base = Impact(speed=2.0)
    print("diameter [mm]   stopping time [ms]   depth [mm]")
    for diameter in (0.005, 0.0075, 0.01, 0.015, 0.02):
        stop = run_impact(replace(base, diameter=diameter)).stop
        if stop is None:
            print(f"{diameter * 1e3:13.1f}   not stopped in {base.duration} s")
        else:
            print(f"{diameter * 1e3:13.1f}   {stop.time * 1e3:18.2f}   {stop.depth * 1e3:10.2f}")


if __name__ == "__main__":
    main()
