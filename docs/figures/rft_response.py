"""Resistance of a plate over tilt and attack: two-dimensional and three-dimensional theory.

Both are divided by the resistance of a level plate that is pushed straight down. Of the plate's two
faces the one that leads is taken.
"""

from __future__ import annotations

import math

import numpy as np
from matplotlib import pyplot as plt
from style import save

from mjgranular import Rft2dLaw, Rft3dLaw, media
from mjgranular.kernel import compiled
from mjgranular.kernel.vector import vector
from mjgranular.law.rft import stress_of
from mjgranular.law.rft2d import rft2d_slope
from mjgranular.law.rft3d import rft3d_slope

SAND = media["quikrete_medium"]


def numbers_of(slope: object) -> object:
    """Makes the stress of a law of numbers: normal, direction of motion, surface's normal."""
    stress = stress_of(slope)

    @compiled
    def call(law, g, nx, ny, nz, vx, vy, vz, zx, zy, zz):
        f = stress(law, g, vector(nx, ny, nz), vector(vx, vy, vz), vector(zx, zy, zz))
        return f.x, f.y, f.z

    return call


LAWS = {
    "2D, generic (Li et al. 2013)": (Rft2dLaw.generic(1.0), numbers_of(rft2d_slope)),
    "3D, $\\mu_s$ = 0.4 (Agarwal et al. 2023)": (
        Rft3dLaw.from_medium(SAND),
        numbers_of(rft3d_slope),
    ),
}


LEVELS = np.arange(-1.1, 1.11, 0.1)


def responses(law: Rft2dLaw | Rft3dLaw, stress: object, degrees: np.ndarray) -> np.ndarray:
    """(alpha_x against the motion, alpha_z up) over attack (rows) and tilt (columns)."""
    record = law.parameters(SAND)[0]
    found = np.zeros((2, len(degrees), len(degrees)))
    flat = stress(record, 9.81, 0.0, 0.0, -1.0, 0.0, 0.0, -1.0, 0.0, 0.0, 1.0)[2]
    for i, attack in enumerate(np.radians(degrees)):
        v = (math.cos(attack), 0.0, -math.sin(attack))
        for j, tilt in enumerate(np.radians(degrees)):
            n = (math.sin(tilt), 0.0, -math.cos(tilt))
            side = 1.0 if n[0] * v[0] + n[2] * v[2] >= 0 else -1.0
            force = stress(record, 9.81, *(side * k for k in n), *v, 0.0, 0.0, 1.0)
            found[:, i, j] = -force[0] / flat, force[2] / flat
    return found


def main() -> None:
    """Draws the figure and prints extremes."""
    degrees = np.linspace(-89.5, 89.5, 180)
    figure, axes = plt.subplots(2, 2, figsize=(7.4, 6.4), sharex=True, sharey=True)
    image = None
    for column, (name, (law, stress)) in enumerate(LAWS.items()):
        found = responses(law, stress, degrees)
        for row, (what, values) in enumerate(
            zip((r"$\alpha_z$, up", r"$\alpha_x$, against $x$"), found[::-1], strict=True)
        ):
            axis = axes[row, column]
            image = axis.contourf(degrees, degrees, values, LEVELS, cmap="RdBu_r")
            axis.set_title(f"{what}: {name}", fontsize=9)
            axis.grid(visible=False)
            axis.set(xticks=range(-90, 91, 45), yticks=range(-90, 91, 45), aspect=1)
            print(f"{name}, {what}: {values.min():.3f} to {values.max():.3f}")
    for axis in axes[1]:
        axis.set_xlabel(r"tilt $\beta$ [degrees]")
    for axis in axes[:, 0]:
        axis.set_ylabel(r"attack $\gamma$ [degrees]")
    figure.colorbar(image, ax=axes, shrink=0.7, label=r"over $\alpha_z(0, 90^\circ)$")
    save(figure, "rft_response")


if __name__ == "__main__":
    main()
