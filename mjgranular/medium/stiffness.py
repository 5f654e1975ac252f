"""Stiffness of dry grains from their friction: Agarwal, Goldman and Kamrin, PNAS 120 (2023)."""

from numpy.polynomial import Polynomial

FRICTION_CUBIC = Polynomial([0.0, 89.0, -386.0, 894.0])
"""xi_n / (rho_c g) by the coefficient of internal friction mu: 894 mu^3 - 386 mu^2 + 89 mu."""

LEVEL_PLATE = 0.87574
"""|a_z| of the generic response, for a level plate that moves straight down."""
