"""Independent tasks on processes of this machine or on Ray.

Callers need only `map_tasks`. Results survive any end of the run: each is written to a `Journal` as
soon as it exists, so that memory does not grow with them and a later run, on either
engine, resumes from there.
"""

from mjgranular.pool.journal import UNFINISHED as UNFINISHED
from mjgranular.pool.journal import Journal as Journal
from mjgranular.pool.tasks import Failure as Failure
from mjgranular.pool.tasks import Mapped as Mapped
from mjgranular.pool.tasks import map_tasks as map_tasks
from mjgranular.pool.workers import Workers as Workers
