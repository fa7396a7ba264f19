"""Navigation filter for underwater vehicles that learns, online, how each of its sensors errs.

Conventions, stated once.

Frames: ``b`` body forward-right-down, ``n`` local north-east-down, ``e`` Earth (WGS-84). ``C_nb`` takes body to nav:
``v_n = C_nb @ v_b``. ``velocity_n`` [m/s], ``rate_b`` [rad/s] and ``force_b`` [m/s^2] (specific force: (0, 0, -9.8) at
rest and level) carry their frame. Heading is true, clockwise from north; depth is positive down, height positive up.

Signs: error = estimated minus true; residual = measured minus predicted; a correction is ``state.plus(-error)``; the
attitude error is a rotation vector in ``n``. ARMA models read ``A(q) y = C(q) e``, as ``scipy.signal.lfilter([1, *ma],
[1, *ar], e)``.

Units: SI and radians. Names carry the unit where it is not obvious (``time_s``, ``rate_hz``, ``latitude_deg``). Degrees
appear only in `Start`, in the files that are read and written, and in ``Track.to_frame()``. ``sd`` is a standard
deviation, ``density`` a root power spectral density.

Types: descriptions (`Vehicle`, sensors, error models, `Mission`) are frozen values; a `Navigator` is the only thing
that runs and changes; a `Track` is what a run found out.
"""

import sys

from navfilter.foundation.public_names import MovedModules, lazily

__version__ = "0.1.0"
__getattr__, __dir__, __all__, _HOME = lazily(__name__, __file__)
sys.meta_path.append(MovedModules)
