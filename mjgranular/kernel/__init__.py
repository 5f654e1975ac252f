"""Infrastructure of kernels: compilation, MuJoCo's memory, the motion of a body.

Nothing here depends on a law. `compiled` turns a function into machine code that is cached on disk,
`memory` reads arrays of a running simulation by their address, `motion` computes a body's velocity.
"""

from mjgranular.kernel.compiled import compiled as compiled
from mjgranular.kernel.compiled import entry as entry
