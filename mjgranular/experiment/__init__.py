"""Experiments: drops, forces on a path, studies of many; each ends as plain data."""

from mjgranular.experiment.drop import Drop as Drop
from mjgranular.experiment.drop import DropResult as DropResult
from mjgranular.experiment.drop import run_drop as run_drop
from mjgranular.experiment.impact import Impact as Impact
from mjgranular.experiment.impact import ImpactResult as ImpactResult
from mjgranular.experiment.impact import Rest as Rest
from mjgranular.experiment.impact import Stop as Stop
from mjgranular.experiment.impact import run_impact as run_impact
from mjgranular.experiment.intrusion import Intrusion as Intrusion
from mjgranular.experiment.intrusion import IntrusionResult as IntrusionResult
from mjgranular.experiment.intrusion import run_intrusion as run_intrusion
from mjgranular.experiment.study import Study as Study
from mjgranular.experiment.study import StudyResult as StudyResult
from mjgranular.experiment.study import journal_of as journal_of
from mjgranular.experiment.study import run_study as run_study
from mjgranular.experiment.trajectory import Trajectory as Trajectory
