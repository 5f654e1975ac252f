"""Sand in MuJoCo Studio: `python -m mujoco.studio.viewer MODEL.xml --plugins=FILE`.

FILE is `PLUGIN`; `mjgranular studio` prints it. Studio imports it by its place, together with all
that lies beside it: hence a folder of its own.
"""

from pathlib import Path

PLUGIN = Path(__file__).with_name("sand_plugin.py")
"""The file."""
