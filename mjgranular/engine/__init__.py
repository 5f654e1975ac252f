"""The plugin: sand inside plain `mj_step`, declared in MJCF.

`spec` writes the MJCF and `config` reads it; `plugin` registers with MuJoCo through `trampolines`,
machine code in front of Python; `loader` prepares the sand when an `mjData` is made, `block` lays
it out in memory, `handles` maps simulations to blocks; `callbacks` runs at each step; `sensor` and
`draw` read its results, `external` adds them to MuJoCo's own sensors, `looks` says how sand is
drawn, also by Python. `tuning` is sand with its own state; pickled models import `pickles`.
"""

from mjgranular.engine.config import NAME as NAME
from mjgranular.engine.external import rne_post_constraint as rne_post_constraint
from mjgranular.engine.instances import bodies_of_sands
from mjgranular.engine.instances import relief_of as relief_of
from mjgranular.engine.pickles import register as register_pickles
from mjgranular.engine.plugin import register
from mjgranular.engine.spec import add_sand as add_sand
from mjgranular.engine.spec import show_prints as show_prints
from mjgranular.engine.tuning import tune as tune
from mjgranular.sand.binding import ask_about_models

register()
register_pickles()
ask_about_models(bodies_of_sands)
