"""Fits of a medium to measurements: constants of a law, with intervals."""

from mjgranular.fit.body import Body as Body
from mjgranular.fit.fit import Fit as Fit
from mjgranular.fit.fit import run_fit as run_fit
from mjgranular.fit.reader import read_fit as read_fit
from mjgranular.fit.result import FitResult as FitResult
from mjgranular.fit.result import FurtherTest as FurtherTest
from mjgranular.fit.result import RunErrors as RunErrors
from mjgranular.fit.run import Run as Run
