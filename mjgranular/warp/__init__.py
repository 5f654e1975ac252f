"""Sand in thousands of worlds at once with MuJoCo Warp, on GPUs and CPUs.

Modules with kernels do without `from __future__ import annotations`: Warp reads types in place.
"""

from mjgranular._util.checks import require

require("mujoco_warp", extra="warp", purpose="Sand for MuJoCo Warp")

from mjgranular.warp.fit import coupled as coupled  # noqa: E402
from mjgranular.warp.sand import WarpSand as WarpSand  # noqa: E402
