"""How one sensor errs in a campaign, and what its operator believes: the usual errors, those of the thesis among
them, and such as are hard to learn.

The models "of the thesis" are those of J. Ah-Chong, "Static error modeling of sensors applicable to ocean systems",
Florida Atlantic University, 2003, Appendix A; the docstring of each says which table, and what had to be changed before
a stationary process could be drawn from it. Most of the printed models hold a unit root or are unstable, see
`_thesis_compass` and the others.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from navfilter.models.error_models import Arma, ErrorModel, GaussMarkov, RandomWalk, White
from navfilter.models.vehicle import Vehicle
from navfilter.simulation.faults import Changing, Models
from navfilter.simulation.scenarios import COMPASS

_DEG = math.pi / 180.0
_RATE_HZ = 8.0
#: What the operator says of the compass, whatever it really does.
BELIEF = COMPASS + White(sd=0.1 * _DEG)


@dataclass(frozen=True)
class Study:
    """How one sensor really errs in a campaign.

    Parameters
    ----------
    about : str
        One line for listings.
    sensor : str
        Name of the sensor, or "gyro".
    kind : "white", "gm1", "smooth", "oscillating" or "changing"
        What may be expected of a model: whether white or Gauss-Markov noise is the truth, whether the error is coloured
        but smooth (one hump at zero frequency, perhaps on white noise), whether it also swings, or whether no fixed
        model is the truth.
    error : callable
        Takes the vehicle as described and the duration in s, returns the true error of the sensor.
    equip : callable, optional
        Changes the vehicle before the mission: rate, belief, calibration states.
    duration_s : float
        When nothing else is asked for, s.
    rest_s, fixes_s : float
        At rest before the start; under way at the surface, with fixes, before the dive, s.
    leg_m : float
        Length of the lawnmower's legs, m.
    faulty : dict of str to object
        Further faults of the sensor, as `navfilter.simulation.faults.Faults` takes them.
    told : error models, optional
        What `oracle` is told of the sensor where no error model is the whole truth; default: the error.
    really : callable, optional
        The vehicle as it really is, where its operator leaves out more than an error model.
    misled : bool
        Whether the operator is wrong by a factor of 2 in the standard deviation or 5 in the time constant, so that
        learning must be better than the description.
    """

    about: str
    sensor: str
    kind: str
    error: Callable[[Vehicle, float], Models | Changing]
    equip: Callable[[Vehicle], Vehicle] = lambda vehicle: vehicle
    duration_s: float = 1800.0
    rest_s: float = 20.0
    fixes_s: float = 45.0
    leg_m: float = 60.0
    faulty: Mapping[str, Any] = field(default_factory=dict)
    told: Models | None = None
    really: Callable[[Vehicle], Vehicle] = lambda vehicle: vehicle
    misled: bool = False


# --- the errors -----------------------------------------------------------------------------------------------------


def always(error: Models) -> Callable[[Vehicle, float], Models]:
    """An error that does not depend on vehicle and duration."""
    return lambda vehicle, duration_s: error


def with_sensor(vehicle: Vehicle, name: str, **described: Any) -> Vehicle:
    """The vehicle with one of its sensors described otherwise."""
    sensors = {**vehicle.sensors, name: replace(vehicle.sensors[name], **described)}
    return Vehicle(vehicle.drive, sensors, vehicle.name)


def rated(sensor: str, rate_hz: float) -> Callable[[Vehicle], Vehicle]:
    """The vehicle with another rate of one sensor."""

    return lambda vehicle: with_sensor(vehicle, sensor, rate_hz=rate_hz)


def believing(**errors: Models) -> Callable[[Vehicle], Vehicle]:
    """The vehicle whose operator believes in other errors of some sensors."""
    return lambda vehicle: vehicle.with_error(**errors)  # type: ignore[arg-type]


def scaled(ar: tuple[float, ...], ma: tuple[float, ...], sd: float) -> Arma:
    """An ARMA model whose series, not whose innovation, has this standard deviation."""
    return Arma(ar=ar, ma=ma, sd=sd / math.sqrt(Arma(ar=ar, ma=ma, sd=1.0).block(1.0).P0[0, 0]))


def swing(sd: float, period_s: float, radius: float, rate_hz: float = _RATE_HZ) -> Arma:
    """An oscillation as an AR(2): a pair of poles of this radius."""
    return scaled((-2.0 * radius * math.cos(2.0 * math.pi / (period_s * rate_hz)), radius**2), (), sd)


def _slow(sd: float, tau_s: float = 60.0) -> Arma:
    """A slow error that begins smoothly: AR(2) with the pole of `tau_s` at 8 Hz and one at 0.5."""
    pole = math.exp(-1.0 / (tau_s * _RATE_HZ))
    return scaled((-(pole + 0.5), 0.5 * pole), (), sd)


def _mixed() -> Arma:
    """The "compass-like" (4,2): poles 0.97, 0.5 and a pair of radius 0.9 at 0.8 rad; zeros 0.85 and -0.3."""
    pair = 0.9 * np.exp(0.8j)
    ar, ma = np.poly([0.97, 0.5, pair, pair.conjugate()]).real[1:], np.poly([0.85, -0.3])[1:]
    return scaled(tuple(ar.tolist()), tuple(ma.tolist()), 0.63 * _DEG)


# Appendix A, case 2 heading by the whiteness test: (10,0,8), stable as printed (largest pole 0.9991, largest zero
# 0.9931).
LAB1_AR = (-0.986, 0.580, -0.615, -0.652, 0.783, -0.355, 0.377, -0.018, 0.020, -0.133)
LAB1_MA = (-0.931, 0.239, -0.518, -0.515, 0.849, -0.164, 0.191, -0.144)
LAB1_RATE_HZ = 1.0 / 0.1551
# Appendix A, case 4 heading by AIC: (10,0,9), a comb of ten samples. Its largest pole, 0.9999, is a unit root within
# the digits.
LAB2_AR = (1.438, 1.145, 0.417, -0.466, -1.159, -1.419, -1.133, -0.420, 0.431, 0.168)
LAB2_MA = (1.990, 2.403, 2.098, 1.202, 0.075, -0.870, -1.268, -0.988, -0.168)
LAB2_RATE_HZ = 1.0 / 0.11
# Section 4.3.2.2 finds AR(2) sufficient for the longitude but prints only the AR(10), stable (largest pole 0.943). The
# AR(2) here has the autocorrelation of that AR(10) at lags 1 and 2 (Yule-Walker).
GPS_AR = (-0.79427581, -0.17215590)
GPS_RATE_HZ = 1.0 / 0.134


def _thesis_compass() -> Arma:
    """Case 2 as printed. The sd of the innovation is 0.384 deg: the text's variance 0.1473; the table's 0.4358
    disagrees with its AIC.
    """
    return Arma(ar=LAB1_AR, ma=LAB1_MA, sd=math.sqrt(0.1473) * _DEG)


def _comb() -> Arma:
    """Case 4 with its unit root moved to a correlation time of a minute; 0.5 deg (the printed standard deviations
    disagree).
    """
    poles = np.roots([1.0, *LAB2_AR])
    poles[np.argmin(np.abs(poles - 1.0))] = math.exp(-1.0 / (60.0 * LAB2_RATE_HZ))
    return scaled(tuple(np.poly(poles).real[1:].tolist()), LAB2_MA, 0.5 * _DEG)


def _thesis_gps() -> tuple[ErrorModel, ...]:
    """AR(2) of the longitude, 2.27 m per axis (the table's figure read as metres: its unit, minutes, cannot be) and 1.5
    times that down.
    """
    level = scaled(GPS_AR, (), 2.27)
    return level, level, scaled(GPS_AR, (), 1.5 * 2.27)


def _thesis_gyro(vehicle: Vehicle, duration_s: float) -> tuple[ErrorModel, ...]:
    """The (2,2) part of the roll rate's (3,0,3), a line next to the Nyquist frequency; size and bias are those of the
    vehicle's gyro.

    The printed model is not stable (pole 1.0003). That pole and the zero 0.994 next to it are a bias that wanders under
    white noise, which the vehicle's description has already; what is left is stable: poles 0.9994, zeros 0.9924, at 179
    and 178 degrees. Section 4.4.2 calls (2,2) sufficient for all three axes but prints no coefficients of that order.
    """
    pole, zero = -0.99912509 + 0.02234216j, -0.99197650 + 0.03063750j
    ar, ma = (-2.0 * pole.real, abs(pole) ** 2), (-2.0 * zero.real, abs(zero) ** 2)
    imu = vehicle.drive
    errors: list[ErrorModel] = []
    for model in imu.models[:3]:
        block = model.block(imu.period_s)
        at_zero = (1.0 + sum(ma)) / (1.0 + sum(ar))
        walk = next(part for part in model.terms if isinstance(part, RandomWalk))
        # the same density at low frequencies as the white noise that the operator believes in
        errors.append(walk + Arma(ar=ar, ma=ma, sd=math.sqrt(block.r) / at_zero))
    return tuple(errors)


def _waves(vehicle: Vehicle, duration_s: float) -> tuple[ErrorModel, ...]:
    """DVL: a slow error and one that swings with the waves, on white noise; the vertical axis is quiet."""
    level = GaussMarkov(sd=0.008, tau_s=20.0) + swing(0.012, 7.0, 0.96, 4.0) + White(sd=0.006)
    return level, level, GaussMarkov(sd=0.003, tau_s=20.0) + White(sd=0.006)


def _calibrating(vehicle: Vehicle) -> Vehicle:
    """The vehicle whose DVL has a scale error and a misalignment as states, 0.5 % and 0.3 deg."""
    return with_sensor(vehicle, "dvl", scale_sd=0.005, misalignment_sd_rad=0.3 * _DEG)


def _changes(before: ErrorModel, after: ErrorModel) -> Callable[[Vehicle, float], Changing]:
    """After a third of the mission."""
    return lambda vehicle, duration_s: Changing(((0.0, before), (duration_s / 3.0, after)))


def compass(about: str, kind: str, error: ErrorModel, rate_hz: float = _RATE_HZ, **more: Any) -> Study:
    """A compass with this error, its operator's belief being `BELIEF` unless `more` says otherwise."""
    return Study(about, "compass", kind, always(error), **{"equip": rated("compass", rate_hz), **more})


_GM1 = GaussMarkov(sd=0.5 * _DEG, tau_s=15.0)

#: The usual scenarios by name.
USUAL: dict[str, Study] = {
    "compass-white": compass("white, 0.5 deg", "white", White(sd=0.5 * _DEG), misled=True),
    "compass-gm1": compass("first-order Gauss-Markov, 0.5 deg, 15 s", "gm1", _GM1),
    "compass-gm1-white": compass("the same on white noise of 0.3 deg", "smooth", _GM1 + White(sd=0.3 * _DEG)),
    "compass-gm2": compass("second-order Gauss-Markov, 0.5 deg, 10 "
                            "s", "smooth", GaussMarkov(sd=0.5 * _DEG, tau_s=10.0, order=2)),
    "compass-mixed": compass("a hump, a wide peak at 1 Hz and white noise: ARMA(4,2), 0.63 deg", "smooth", _mixed(),
                             misled=True),
    "compass-swell": compass("slow, and swings with a period of 6 s: ARMA(4,2), 0.5 deg", "oscillating",
                              _slow(0.35 * _DEG) + swing(0.35 * _DEG, 6.0, 0.99)),
    "compass-rolling": compass("slow, and swings with a period of 1.5 s: ARMA(4,2), 0.5 deg", "oscillating",
                                _slow(0.35 * _DEG) + swing(0.35 * _DEG, 1.5, 0.95)),
    "compass-comb": compass("thesis, case 4: slow, and a comb of ten samples: ARMA(10,9), 0.5 "
                             "deg", "oscillating", _comb(), LAB2_RATE_HZ),
    "compass-thesis": compass("thesis, case 2 as printed: ARMA(10,8), 0.43 "
                               "deg", "smooth", _thesis_compass(), LAB1_RATE_HZ, misled=True),
    "gps-thesis": Study("thesis, longitude: AR(2), 2.3 m; a third of the way at the surface", "gps", "smooth",
                        always(_thesis_gps()), rated("gps", GPS_RATE_HZ), 2700.0, fixes_s=1080.0,
                        misled=True),
    "gyro-thesis": Study("thesis, roll rate: bias and ARMA(2,2) at the Nyquist frequency; long rest "
                         "first", "gyro", "smooth",
                         _thesis_gyro, rest_s=180.0),
    "dvl-coloured": Study("DVL slow and with the waves, ARMA(3,3), with scale and misalignment as "
                          "states", "dvl", "oscillating",
                          _waves, _calibrating, 2700.0, misled=True),
    "compass-triples": Study("Gauss-Markov whose standard deviation trebles after a third", "compass", "changing",
                             _changes(_GM1, GaussMarkov(sd=1.5 * _DEG, tau_s=15.0)), duration_s=2700.0),
    "compass-recoloured": Study("Gauss-Markov that becomes white noise and a swing of 1.5 s after a "
                                "third", "compass", "changing",
                                _changes(_GM1, White(sd=0.3 * _DEG) + swing(0.5 * _DEG, 1.5, 0.95)), duration_s=2700.0),
}  # fmt: skip


# --- errors that are hard to learn -----------------------------------------------------------------------------------


def _slow_on_white(sd: float, tau_s: float, white: float, order: int = 1) -> ErrorModel:
    return GaussMarkov(sd=sd, tau_s=tau_s, order=order) + White(sd=white)


def _slow_deg(sd: float, tau_s: float, white: float, order: int = 1) -> ErrorModel:
    return _slow_on_white(sd * _DEG, tau_s, white * _DEG, order)


def _wrong(sd: float, tau_s: float, what: str) -> Study:
    """Gauss-Markov on white noise, described as such, but with another standard deviation [deg] or time constant."""
    about = f"Gauss-Markov, 0.5 deg, 60 s, on white noise of 0.2 deg; described with {what}"
    belief = believing(compass=_slow_deg(sd, tau_s, 0.2))
    return compass(about, "smooth", _slow_deg(0.5, 60.0, 0.2), equip=belief, misled=True)


def _short(minutes: int) -> Study:
    error = _slow_deg(0.4, 120.0, 0.1) + swing(0.3 * _DEG, 6.0, 0.98)
    about = f"{minutes} minutes; slow, 0.4 deg, 2 min, a swing of 6 s and white noise"
    # little time at the surface and short legs, so that there are turns in five minutes
    return compass(about, "oscillating", error, duration_s=60.0 * minutes, fixes_s=20.0, leg_m=20.0)


def _deviating(vehicle: Vehicle) -> Vehicle:
    """The vehicle whose compass has one-cycle and two-cycle deviations of 0.7 and 0.3 deg."""
    return with_sensor(vehicle, "compass", deviation_sd_rad=(0.7 * _DEG, 0.3 * _DEG))


#: A Gauss-Markov process not far from what is believed, where something else is the trouble.
_KNOWN = _slow_deg(0.35, 60.0, 0.1)
_TENTH = 0.1

#: The hard scenarios by name.
HARD: dict[str, Study] = {
    "compass-slow-10min": compass(
        "slow, 0.5 deg, 10 min, on white noise of 0.2 deg", "smooth", _slow_deg(0.5, 600.0, 0.2), misled=True
    ),
    "compass-slow-2min": compass("the same with 2 min", "smooth", _slow_deg(0.5, 120.0, 0.2)),
    "compass-gm2-40s": compass(
        "second-order Gauss-Markov, 0.6 deg, 40 s, on white noise of 0.1 deg", "smooth", _slow_deg(0.6, 40.0, 0.1, 2)
    ),
    "compass-two-swings": compass(
        "slow, 0.3 deg, 200 s, and swings of 4 and 9 s, 0.4 and 0.3 deg",
        "oscillating",
        GaussMarkov(sd=0.3 * _DEG, tau_s=200.0) + swing(0.4 * _DEG, 4.0, 0.97) + swing(0.3 * _DEG, 9.0, 0.99),
        misled=True,
    ),
    "compass-coarse": compass(
        "Gauss-Markov, 0.35 deg, 60 s, read in whole degrees",
        "smooth",
        _KNOWN,
        faulty={"quantisation": 1.0 * _DEG},
        told=_slow_deg(0.35, 60.0, math.hypot(0.1, 1.0 / math.sqrt(12.0))),
    ),
    "compass-tails": compass(
        "Gauss-Markov, 0.35 deg, 60 s; white noise of 0.1 deg, one reading in ten a further 1 deg",
        "smooth",
        _KNOWN,
        faulty={"outlier_probability": _TENTH, "outlier_sd": 1.0 * _DEG},
        told=_slow_deg(0.35, 60.0, math.hypot(0.1, math.sqrt(_TENTH))),
    ),
    "compass-deviation": compass(
        "Gauss-Markov, 0.35 deg, 60 s; deviates with the heading, undescribed", "smooth", _KNOWN, really=_deviating
    ),
    "compass-sd-over": _wrong(1.5, 60.0, "three times the standard deviation"),
    "compass-sd-under": _wrong(0.5 / 3.0, 60.0, "a third of the standard deviation"),
    "compass-tau-over": _wrong(0.5, 600.0, "ten times the time constant"),
    "compass-tau-under": _wrong(0.5, 6.0, "a tenth of the time constant"),
    "compass-5min": _short(5),
    "compass-10min": _short(10),
    "dvl-slow": Study(
        "DVL slow, 2 cm/s, 2 min (down 5 mm/s), on white noise of 1 cm/s",
        "dvl",
        "smooth",
        always(
            (_slow_on_white(0.02, 120.0, 0.01), _slow_on_white(0.02, 120.0, 0.01), _slow_on_white(0.005, 120.0, 0.01))
        ),
        believing(dvl=_slow_on_white(0.01, 60.0, 0.01)),
        misled=True,
    ),
    "gps-slow": Study(
        "fixes slow, 2 m, 200 s, on white noise of 0.5 m; half of the way at the surface",
        "gps",
        "smooth",
        always(_slow_on_white(2.0, 200.0, 0.5)),
        believing(gps=_slow_on_white(3.0, 60.0, 0.5)),
        fixes_s=900.0,
    ),
    "depth-slow": Study(
        "depth slow, 0.3 m, 200 s, on white noise of 5 cm",
        "depth",
        "smooth",
        always(_slow_on_white(0.3, 200.0, 0.05)),
        believing(depth=_slow_on_white(0.1, 60.0, 0.05)),
        misled=True,
    ),
}
