"""Independent tasks on processes of this machine or on Ray.

Callers need only `map_tasks`. Each result is written to a `Journal` as soon as it exists: memory
does not grow with them, and after any end of the run a later one, on either engine, resumes.
"""

from mjgranular.pool.journal import UNFINISHED as UNFINISHED
from mjgranular.pool.journal import Journal as Journal
from mjgranular.pool.tasks import Failure as Failure
from mjgranular.pool.tasks import Mapped as Mapped
from mjgranular.pool.tasks import map_tasks as map_tasks
from mjgranular.pool.workers import Workers as Workers
