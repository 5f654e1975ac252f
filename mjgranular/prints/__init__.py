"""Drawing of tracks: a skin of the model that takes the shape of sand with memory."""

from mjgranular.prints.cover import Cover as Cover
from mjgranular.prints.record import Prints as Prints
from mjgranular.prints.record import PrintsRecorder as PrintsRecorder
from mjgranular.prints.record import Replay as Replay
from mjgranular.prints.skin import add_skin as add_skin
