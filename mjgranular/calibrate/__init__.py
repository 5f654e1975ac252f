"""Constants of a law fitted to measured runs, and errors of a law against measured runs."""

from mjgranular.calibrate.fit import Fit as Fit
from mjgranular.calibrate.fit import FitResult as FitResult
from mjgranular.calibrate.fit import run_fit as run_fit
from mjgranular.calibrate.motion import Errors as Errors
from mjgranular.calibrate.motion import Motion as Motion
from mjgranular.calibrate.motion import compare as compare
from mjgranular.calibrate.reader import read_fit as read_fit
from mjgranular.calibrate.reader import read_runs as read_runs
from mjgranular.calibrate.runs import MARKS as MARKS
from mjgranular.calibrate.runs import Body as Body
from mjgranular.calibrate.runs import MeasuredRun as MeasuredRun
from mjgranular.calibrate.runs import Run as Run
from mjgranular.calibrate.runs import RunSet as RunSet
from mjgranular.calibrate.simulate import simulate as simulate
