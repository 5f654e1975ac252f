"""The referee: measured motion, the same motion simulated with a law, and its errors."""

from mjgranular.referee.errors import Errors as Errors
from mjgranular.referee.errors import compare as compare
from mjgranular.referee.motion import Motion as Motion
from mjgranular.referee.runs import MARKS as MARKS
from mjgranular.referee.runs import MeasuredRun as MeasuredRun
from mjgranular.referee.runs import RunSet as RunSet
from mjgranular.referee.runs import read_runs as read_runs
from mjgranular.referee.simulate import simulate as simulate
