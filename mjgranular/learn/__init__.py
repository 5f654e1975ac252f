"""Training, evaluating and filming policies. Needs the extra `train`; imported where it is used.

A run is a folder: settings become environments and an algorithm, these become checkpoints, and the
newest checkpoint is the policy that is evaluated and filmed.
"""

from mjgranular.learn.settings import Settings as Settings
from mjgranular.learn.settings import change as change
from mjgranular.learn.settings import find_settings as find_settings
