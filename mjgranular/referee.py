"""Alias: the names of `mjgranular.calibrate` that score a law against measured runs."""

from mjgranular.calibrate import MARKS as MARKS
from mjgranular.calibrate import Errors as Errors
from mjgranular.calibrate import MeasuredRun as MeasuredRun
from mjgranular.calibrate import Motion as Motion
from mjgranular.calibrate import RunSet as RunSet
from mjgranular.calibrate import compare as compare
from mjgranular.calibrate import read_runs as read_runs
from mjgranular.calibrate import simulate as simulate
