"""Navigation filter for underwater vehicles that learns, online, how each of its sensors errs.

Conventions, stated once.

Frames: ``b`` body forward-right-down, ``n`` local north-east-down, ``e`` Earth (WGS-84). ``C_nb`` takes body to nav:
``v_n = C_nb @ v_b``. ``velocity_n`` [m/s], ``rate_b`` [rad/s] and ``force_b`` [m/s^2] (specific force: (0, 0, -9.8) at rest and level) carry
their frame. Heading is true, clockwise from north; depth is positive down, height positive up.

Signs: error = estimated minus true; residual = measured minus predicted; a correction is ``state.plus(-error)``; the attitude error is a
rotation vector in ``n``. ARMA models read ``A(q) y = C(q) e``, as ``scipy.signal.lfilter([1, *ma], [1, *ar], e)``.

Units: SI and radians. Names carry the unit where it is not obvious (``time_s``, ``rate_hz``, ``latitude_deg``). Degrees appear only in
`Start`, in the files that are read and written, and in ``Track.to_frame()``. ``sd`` is a standard deviation, ``density`` a root power spectral
density.

Types: descriptions (`Vehicle`, sensors, error models, `Mission`) are frozen values; a `Navigator` is the only thing that runs and changes;
a `Track` is what a run found out.
"""

from navfilter.alignment import align
from navfilter.error_models import Arma, ErrorModel, GaussMarkov, RandomWalk, White
from navfilter.io import read_mission, read_vehicle
from navfilter.magnetic import calibrate_magnetometer, declination
from navfilter.mechanisation import DeadReckoning, Imu
from navfilter.mission import Mission, Stream
from navfilter.navigator import Navigator, Outcome
from navfilter.replay import replay, warm_up
from navfilter.sensors import BodyVelocity, Depth, Heading, Position, ZeroVelocity
from navfilter.state import NavState
from navfilter.tape import Tape
from navfilter.track import Track
from navfilter.vehicle import Start, Vehicle


from navfilter.arma import ArmaModel, forecast_arma, is_stable, log_s0_sd, simulate_arma
from navfilter.arma_algebra import BiasPlusWhite, add_arma, bias_plus_white, resample_arma, spectral_factor
from navfilter.diagnostics import Whiteness, acf, allan_deviation, cross_correlation, pacf, whiteness
from navfilter.fit import ArmaFit, fit_arma
from navfilter.gauss_markov import GaussMarkovFit, correlation_product, fit_gauss_markov, gauss_markov_arma
from navfilter.order import OrderTable, select_order
from navfilter.starts import burg, hannan_rissanen, yule_walker

from navfilter.bank import ArmaBank
from navfilter.front_end import FrontEnd
from navfilter.online import RecursiveArma
from navfilter.periodic_motion import find_motion_band, subtract_motion
from navfilter.unit_root import split_bias
