"""Independent tasks in chunks, on processes of this machine or on Ray.

`map_tasks` is all that callers need. Results come back whatever ends the run: each is written to a
`Journal` as soon as its chunk is finished, so that memory does not grow with them and a later run,
on either engine, goes on from there.
"""

from mjgranular.pool.journal import UNFINISHED as UNFINISHED
from mjgranular.pool.journal import Journal as Journal
from mjgranular.pool.tasks import Failure as Failure
from mjgranular.pool.tasks import Mapped as Mapped
from mjgranular.pool.tasks import map_tasks as map_tasks
from mjgranular.pool.workers import Workers as Workers
