"""Sand in MuJoCo scenes: its material, its tracks, and daylight."""

from mjgranular.render.skin import add_skin as add_skin
from mjgranular.render.tracks import Replay as Replay
from mjgranular.render.tracks import TrackRecorder as TrackRecorder
from mjgranular.render.tracks import Tracks as Tracks
