"""Alias of `mjgranular.calibrate`, where fits were before."""

from mjgranular.calibrate import *  # noqa: F403
from mjgranular.calibrate import Errors

RunErrors = Errors
