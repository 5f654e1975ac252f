"""Alias: the names of `mjgranular.calibrate` that fit constants."""

from mjgranular.calibrate import Body as Body
from mjgranular.calibrate import Errors
from mjgranular.calibrate import Fit as Fit
from mjgranular.calibrate import FitResult as FitResult
from mjgranular.calibrate import Run as Run
from mjgranular.calibrate import read_fit as read_fit
from mjgranular.calibrate import run_fit as run_fit

RunErrors = Errors
