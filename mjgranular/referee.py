"""Alias of `mjgranular.calibrate`, where scores of laws against measured runs were before."""

from mjgranular.calibrate import *  # noqa: F403
