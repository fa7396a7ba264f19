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
    "models.alignment": "align",
    "calibration.beacons": "locate_beacons",
    "calibration.calibrate": "Calibration calibrate",
    "calibration.over_dives": "learn",
    "timeseries.fit": "fit_arma",
    "timeseries.model": "ArmaModel simulate_arma",
    "timeseries.online.recursive": "RecursiveArma",
    "timeseries.order": "select_order",
    "evaluation.comparison": "Comparison compare",
    "timeseries.diagnostics": "acf pacf whiteness",
    "models.periodic_error": "Cycle",
    "models.error_models": "Arma Block ErrorModel GaussMarkov RandomWalk White",
    "io": "read_mission read_vehicle",
    "models.learned_arma": "LearnedArma",
    "models.magnetic": "calibrate_magnetometer declination",
    "models.mechanisation": "DeadReckoning Imu",
    "navigation.lanes.navigator": "LaneNavigator",
    "models.mission": "Mission Stream",
    "navigation.navigator": "Navigator Outcome",
    "io.tracks.formats": "write_track",
    "playback.replay": "replay",
    "evaluation.baselines": "rival",
    "models.sensors": "Altitude Attitude BodyVelocity Course Depth DvlBeams Heading Odometer Position Range Usbl "
    "WaterVelocity ZeroRate ZeroVelocity",
    "models.parameters": "Parameter",
    "models.sensors.observable": "Observable",
    "models.sensors.sensor": "Sensor",
    "models.state": "NavState",
    "filter.records": "Tape",
    "track.track": "Track",
    "models.start": "Start",
    "models.vehicle": "Vehicle",
    "playback.warm_up": "warm_up",
}
_HOME = {name: module for module, names in _FACE.items() for name in names.split()}
__all__ = sorted(_HOME)


# For checkers and editors, which do not run what follows.
if TYPE_CHECKING:
    from navfilter.calibration.beacons import locate_beacons as locate_beacons
    from navfilter.calibration.calibrate import Calibration as Calibration
    from navfilter.calibration.calibrate import calibrate as calibrate
    from navfilter.calibration.over_dives import learn as learn
    from navfilter.evaluation.baselines import rival as rival
    from navfilter.evaluation.comparison import Comparison as Comparison
    from navfilter.evaluation.comparison import compare as compare
    from navfilter.filter.records import Tape as Tape
    from navfilter.io import read_mission as read_mission
    from navfilter.io import read_vehicle as read_vehicle
    from navfilter.io.tracks.formats import write_track as write_track
    from navfilter.models.alignment import align as align
    from navfilter.models.error_models import Arma as Arma
    from navfilter.models.error_models import Block as Block
    from navfilter.models.error_models import ErrorModel as ErrorModel
    from navfilter.models.error_models import GaussMarkov as GaussMarkov
    from navfilter.models.error_models import RandomWalk as RandomWalk
    from navfilter.models.error_models import White as White
    from navfilter.models.learned_arma import LearnedArma as LearnedArma
    from navfilter.models.magnetic import calibrate_magnetometer as calibrate_magnetometer
    from navfilter.models.magnetic import declination as declination
    from navfilter.models.mechanisation import DeadReckoning as DeadReckoning
    from navfilter.models.mechanisation import Imu as Imu
    from navfilter.models.mission import Mission as Mission
    from navfilter.models.mission import Stream as Stream
    from navfilter.models.parameters import Parameter as Parameter
    from navfilter.models.periodic_error import Cycle as Cycle
    from navfilter.models.sensors import Altitude as Altitude
    from navfilter.models.sensors import Attitude as Attitude
    from navfilter.models.sensors import BodyVelocity as BodyVelocity
    from navfilter.models.sensors import Course as Course
    from navfilter.models.sensors import Depth as Depth
    from navfilter.models.sensors import DvlBeams as DvlBeams
    from navfilter.models.sensors import Heading as Heading
    from navfilter.models.sensors import Odometer as Odometer
    from navfilter.models.sensors import Position as Position
    from navfilter.models.sensors import Range as Range
    from navfilter.models.sensors import Usbl as Usbl
    from navfilter.models.sensors import WaterVelocity as WaterVelocity
    from navfilter.models.sensors import ZeroRate as ZeroRate
    from navfilter.models.sensors import ZeroVelocity as ZeroVelocity
    from navfilter.models.sensors.observable import Observable as Observable
    from navfilter.models.sensors.sensor import Sensor as Sensor
    from navfilter.models.start import Start as Start
    from navfilter.models.state import NavState as NavState
    from navfilter.models.vehicle import Vehicle as Vehicle
    from navfilter.navigation.lanes.navigator import LaneNavigator as LaneNavigator
    from navfilter.navigation.navigator import Navigator as Navigator
    from navfilter.navigation.navigator import Outcome as Outcome
    from navfilter.playback.replay import replay as replay
    from navfilter.playback.warm_up import warm_up as warm_up
    from navfilter.timeseries.diagnostics import acf as acf
    from navfilter.timeseries.diagnostics import pacf as pacf
    from navfilter.timeseries.diagnostics import whiteness as whiteness
    from navfilter.timeseries.fit import fit_arma as fit_arma
    from navfilter.timeseries.model import ArmaModel as ArmaModel
    from navfilter.timeseries.model import simulate_arma as simulate_arma
    from navfilter.timeseries.online.recursive import RecursiveArma as RecursiveArma
    from navfilter.timeseries.order import select_order as select_order
    from navfilter.track.track import Track as Track


class _Moved:
    """Asked last: tells who imports a module by an old path where it is now."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> None:
        if name.startswith("navfilter."):
            from navfilter.foundation.moved_modules import refuse_moved

            refuse_moved(name)


sys.meta_path.append(_Moved)


def __getattr__(name: str) -> Any:
    if name == "timeseries":
        return importlib.import_module("navfilter.timeseries")
    if name not in _HOME:
        # with these two Python says what may have been meant
        raise AttributeError(f"module 'navfilter' has no attribute '{name}'", name=name, obj=sys.modules[__name__])
    value = getattr(importlib.import_module(f"navfilter.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, *(name for name in globals() if name.startswith("__"))])
