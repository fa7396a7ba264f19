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
import sys
from typing import TYPE_CHECKING, Any

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
    "lanes": "LaneNavigator",
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


# For checkers and editors, which do not run what follows.
if TYPE_CHECKING:
    from navfilter.alignment import align as align
    from navfilter.arma.algebra import BiasPlusWhite as BiasPlusWhite
    from navfilter.arma.algebra import add_arma as add_arma
    from navfilter.arma.algebra import bias_plus_white as bias_plus_white
    from navfilter.arma.algebra import resample_arma as resample_arma
    from navfilter.arma.algebra import split_bias as split_bias
    from navfilter.arma.fit import ArmaFit as ArmaFit
    from navfilter.arma.fit import fit_arma as fit_arma
    from navfilter.arma.gauss_markov import GaussMarkovFit as GaussMarkovFit
    from navfilter.arma.gauss_markov import correlation_product as correlation_product
    from navfilter.arma.gauss_markov import fit_gauss_markov as fit_gauss_markov
    from navfilter.arma.gauss_markov import gauss_markov_arma as gauss_markov_arma
    from navfilter.arma.model import ArmaModel as ArmaModel
    from navfilter.arma.model import forecast_arma as forecast_arma
    from navfilter.arma.model import log_s0_sd as log_s0_sd
    from navfilter.arma.model import simulate_arma as simulate_arma
    from navfilter.arma.online.bank import ArmaBank as ArmaBank
    from navfilter.arma.online.front_end import FrontEnd as FrontEnd
    from navfilter.arma.online.recursive import RecursiveArma as RecursiveArma
    from navfilter.arma.order import OrderTable as OrderTable
    from navfilter.arma.order import select_order as select_order
    from navfilter.arma.periodic_motion import find_motion_band as find_motion_band
    from navfilter.arma.periodic_motion import subtract_motion as subtract_motion
    from navfilter.arma.roots import is_stable as is_stable
    from navfilter.arma.spectral import spectral_factor as spectral_factor
    from navfilter.arma.starts import burg as burg
    from navfilter.arma.starts import hannan_rissanen as hannan_rissanen
    from navfilter.arma.starts import yule_walker as yule_walker
    from navfilter.beacons import locate_beacons as locate_beacons
    from navfilter.calibration.calibrate import Calibration as Calibration
    from navfilter.calibration.calibrate import calibrate as calibrate
    from navfilter.cycle import Cycle as Cycle
    from navfilter.diagnostics import Whiteness as Whiteness
    from navfilter.diagnostics import acf as acf
    from navfilter.diagnostics import allan_deviation as allan_deviation
    from navfilter.diagnostics import allan_edf as allan_edf
    from navfilter.diagnostics import cross_correlation as cross_correlation
    from navfilter.diagnostics import pacf as pacf
    from navfilter.diagnostics import whiteness as whiteness
    from navfilter.error_models import Arma as Arma
    from navfilter.error_models import ErrorModel as ErrorModel
    from navfilter.error_models import GaussMarkov as GaussMarkov
    from navfilter.error_models import RandomWalk as RandomWalk
    from navfilter.error_models import White as White
    from navfilter.evaluation.comparison import Comparison as Comparison
    from navfilter.evaluation.comparison import compare as compare
    from navfilter.evaluation.rivals import rival as rival
    from navfilter.filter.tape import Tape as Tape
    from navfilter.io import read_mission as read_mission
    from navfilter.io import read_vehicle as read_vehicle
    from navfilter.lanes import LaneNavigator as LaneNavigator
    from navfilter.learning.learned import LearnedArma as LearnedArma
    from navfilter.magnetic import calibrate_magnetometer as calibrate_magnetometer
    from navfilter.magnetic import declination as declination
    from navfilter.mechanisation import DeadReckoning as DeadReckoning
    from navfilter.mechanisation import Imu as Imu
    from navfilter.mission import Mission as Mission
    from navfilter.mission import Stream as Stream
    from navfilter.navigator import Navigator as Navigator
    from navfilter.navigator import Outcome as Outcome
    from navfilter.outputs.formats import write_track as write_track
    from navfilter.playback import replay as replay
    from navfilter.sensors import Altitude as Altitude
    from navfilter.sensors import Attitude as Attitude
    from navfilter.sensors import BodyVelocity as BodyVelocity
    from navfilter.sensors import Course as Course
    from navfilter.sensors import Depth as Depth
    from navfilter.sensors import DvlBeams as DvlBeams
    from navfilter.sensors import Heading as Heading
    from navfilter.sensors import Odometer as Odometer
    from navfilter.sensors import Position as Position
    from navfilter.sensors import Range as Range
    from navfilter.sensors import Usbl as Usbl
    from navfilter.sensors import WaterVelocity as WaterVelocity
    from navfilter.sensors import ZeroRate as ZeroRate
    from navfilter.sensors import ZeroVelocity as ZeroVelocity
    from navfilter.start import Start as Start
    from navfilter.state import NavState as NavState
    from navfilter.track import Track as Track
    from navfilter.vehicle import Vehicle as Vehicle
    from navfilter.warming import warm_up as warm_up


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        # with these two Python says what may have been meant
        raise AttributeError(f"module 'navfilter' has no attribute '{name}'", name=name, obj=sys.modules[__name__])
    value = getattr(importlib.import_module(f"navfilter.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, *(name for name in globals() if name.startswith("__"))])
