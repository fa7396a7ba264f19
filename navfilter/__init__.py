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

import importlib
from typing import Any

__version__ = "0.1.0"

#: Public names by the module that holds them; imported when first used, so that ``navfilter --help`` answers at once.
_FACE = {
    "alignment": "align",
    "arma.algebra": "BiasPlusWhite add_arma bias_plus_white resample_arma split_bias",
    "beacons": "locate_beacons",
    "calibration.calibrate": "Calibration calibrate",
    "arma.online.bank": "ArmaBank",
    "arma.fit": "ArmaFit fit_arma",
    "arma.online.front_end": "FrontEnd",
    "arma.gauss_markov": "GaussMarkovFit correlation_product fit_gauss_markov gauss_markov_arma",
    "arma.model": "ArmaModel forecast_arma log_s0_sd simulate_arma",
    "arma.online.recursive": "RecursiveArma",
    "arma.order": "OrderTable select_order",
    "arma.periodic_motion": "find_motion_band subtract_motion",
    "arma.roots": "is_stable",
    "arma.spectral": "spectral_factor",
    "arma.starts": "burg hannan_rissanen yule_walker",
    "evaluation.comparison": "Comparison compare",
    "diagnostics": "Whiteness acf allan_deviation allan_edf cross_correlation pacf whiteness",
    "cycle": "Cycle",
    "error_models": "Arma ErrorModel GaussMarkov RandomWalk White",
    "io": "read_mission read_vehicle",
    "learning.learned": "LearnedArma",
    "magnetic": "calibrate_magnetometer declination",
    "mechanisation": "DeadReckoning Imu",
    "mission": "Mission Stream",
    "navigator": "Navigator Outcome",
    "outputs.formats": "write_track",
    "playback": "replay",
    "evaluation.rivals": "rival",
    "sensors": "Altitude Attitude BodyVelocity Course Depth DvlBeams Heading Odometer Position Range Usbl "
    "WaterVelocity ZeroRate ZeroVelocity",
    "state": "NavState",
    "filter.tape": "Tape",
    "track": "Track",
    "start": "Start",
    "vehicle": "Vehicle",
    "warming": "warm_up",
}
_HOME = {name: module for module, names in _FACE.items() for name in names.split()}
__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'navfilter' has no attribute '{name}'")
    value = getattr(importlib.import_module(f"navfilter.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})
