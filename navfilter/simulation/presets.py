"""Error models and sensors by their name on the nameplate: the instruments of the thesis, and two grades of gyro.

The instruments are those of Table 2.1 of J. Ah-Chong, "Static error modeling of sensors applicable to ocean systems",
Florida Atlantic University, 2003. The table is terse. Where an entry can be read in more than one way, the docstring of
the preset says how it is read here; figures that are not in the table at all are called assumptions.
"""

import math

from navfilter.foundation.constants import MILLI_G
from navfilter.models.error_models import ErrorModel, GaussMarkov, RandomWalk, White
from navfilter.models.mechanisation import Imu
from navfilter.models.sensors import BodyVelocity, Depth, Heading, Position

_DEG = math.pi / 180.0
_HOUR_S = 3600.0


def gyro_error(
    random_walk_deg_per_root_hour: float, bias_deg_per_hour: float, bias_change_deg_per_hour: float
) -> ErrorModel:
    """Error of a gyro from the three figures of a data sheet.

    Parameters
    ----------
    random_walk_deg_per_root_hour : float
        Angle random walk, deg/sqrt(h): white noise of the rate.
    bias_deg_per_hour : float
        Standard deviation of the bias that is left at the start, deg/h.
    bias_change_deg_per_hour : float
        Standard deviation by which the bias changes in one hour, deg/h.

    Returns
    -------
    ErrorModel
        In rad/s.

    Examples
    --------
    >>> white, walk = gyro_error(0.3, 5.0, 2.0).parts
    >>> round(white.density, 8), round(walk.start_sd, 8)
    (8.727e-05, 2.424e-05)
    """
    white = White(density=random_walk_deg_per_root_hour * _DEG / math.sqrt(_HOUR_S))
    change = bias_change_deg_per_hour * _DEG / _HOUR_S
    return white + RandomWalk(density=change / math.sqrt(_HOUR_S), start_sd=bias_deg_per_hour * _DEG / _HOUR_S)


def accel_error(
    noise_milli_g_per_root_hz: float, bias_milli_g: float, bias_change_milli_g_per_hour: float
) -> ErrorModel:
    """Error of an accelerometer, in m/s^2: white noise, bias left at the start, change of the bias in one hour."""
    white = White(density=noise_milli_g_per_root_hz * MILLI_G)
    change = bias_change_milli_g_per_hour * MILLI_G
    return white + RandomWalk(density=change / math.sqrt(_HOUR_S), start_sd=bias_milli_g * MILLI_G)


def tactical_imu(rate_hz: float = 100.0, *, increments: bool = False) -> Imu:
    """Inertial unit of tactical grade (fibre-optic): 0.3 deg/sqrt(h), 5 deg/h, accelerometers 0.1 mg/sqrt(Hz), 1 mg."""
    return Imu(
        rate_hz=rate_hz, gyro=gyro_error(0.3, 5.0, 1.0), accel=accel_error(0.1, 1.0, 0.05), increments=increments
    )


def mems_imu(rate_hz: float = 100.0, *, increments: bool = False) -> Imu:
    """Inertial unit of micromechanical grade: 3 deg/sqrt(h), 60 deg/h, accelerometers 0.2 mg/sqrt(Hz), 4 mg."""
    return Imu(
        rate_hz=rate_hz, gyro=gyro_error(3.0, 60.0, 20.0), accel=accel_error(0.2, 4.0, 0.3), increments=increments
    )


def crossbow_imu(rate_hz: float = 100.0) -> Imu:
    """Crossbow inertial unit of Table 2.1.

    "Gyro drift < 2.25 deg/hr^1/2" has the unit of an angle random walk and is read as one: 0.0375 deg/s/sqrt(Hz).
    "Accelerometer +-0.25 mg" is read as the standard deviation of one sample at 100 Hz, "bias +-0.5 mg" as the standard
    deviation of the bias at the start. Assumptions, for the table says nothing: a gyro bias of 100 deg/h left after
    warming up, and biases that change by 30 deg/h and 0.1 mg in an hour.
    """
    return Imu(
        rate_hz=rate_hz, gyro=gyro_error(2.25, 100.0, 30.0), accel=accel_error(0.25 / math.sqrt(100.0), 0.5, 0.1)
    )


def tcm2_compass(rate_hz: float = 8.0, *, calibrated: bool = True) -> Heading:
    """Magnetic compass Precision Navigation TCM2 of Table 2.1.

    "+-0.2 microtesla" is the accuracy of its magnetometers; across a horizontal field of 25 microtesla, that of
    Florida, it turns the heading by 0.46 deg, read as a standard deviation. Its error is taken as slow (Gauss-Markov,
    30 s) with 0.1 deg of white noise on top (assumptions; the thesis measured static residuals of 0.4 to 0.6 deg).
    "Bias ~5 deg" is what the vehicle's own iron does: read as the standard deviation of bias and one-cycle deviation
    before a calibration; a tenth of it, and of the two-cycle deviation, is left after one (assumption). The rate is 8
    to 40 Hz.
    """
    left = (0.1 if calibrated else 1.0) * 5.0 * _DEG
    return Heading(
        rate_hz=rate_hz,
        error=White(sd=0.1 * _DEG) + GaussMarkov(sd=math.atan2(0.2, 25.0), tau_s=30.0),
        magnetic=True,
        bias_sd_rad=left,
        deviation_sd_rad=(left, 0.5 * left),
    )


def rdi_dvl(rate_hz: float = 4.0, *, long_range: bool = False) -> BodyVelocity:
    """Doppler velocity log RDI Navigator of Table 2.1.

    "+-0.2 %, +-0.4 %" are read as the scale errors of its short-range (high-frequency) and long-range models, as
    standard deviations, and "bias 0.003 m/s" as that of an additive error which wanders over ten minutes
    (assumption). Assumptions for what the table does not give: white noise of 0.01 m/s a ping, 0.2 deg misalignment.
    """
    return BodyVelocity(
        rate_hz=rate_hz,
        error=White(sd=0.01) + GaussMarkov(sd=0.003, tau_s=600.0),
        scale_sd=0.004 if long_range else 0.002,
        misalignment_sd_rad=0.2 * _DEG,
    )


def motorola_gps(rate_hz: float = 1.0, *, differential: bool = True) -> Position:
    """Satellite receiver Motorola VP Oncore of Table 2.1.

    "GPS < 25 m" is read as two standard deviations per axis of a slow error (selective availability was on: Gauss-
    Markov, 60 s, of second order as the thesis models it), and "DGPS 1-5 m" as 2.5 m with 30 s. "~0.2 m, negligible"
    in the column of the bias is the resolution of the recorded position, 0.0001 minutes of arc, and is taken as white
    noise. Vertical errors are taken as 1.5 times the horizontal ones (assumption).
    """
    sd, tau_s = (2.5, 30.0) if differential else (12.5, 60.0)
    level = White(sd=0.2) + GaussMarkov(sd=sd, tau_s=tau_s, order=2)
    return Position(
        rate_hz=rate_hz, error=(level, level, White(sd=0.3) + GaussMarkov(sd=1.5 * sd, tau_s=tau_s, order=2))
    )


def pressure_depth(rate_hz: float = 1.0) -> Depth:
    """Depth from a good quartz gauge: 5 cm of white noise (assumption; the thesis' table lists no depth sensor)."""
    return Depth(rate_hz=rate_hz, error=White(sd=0.05))
