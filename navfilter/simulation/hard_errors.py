"""Scenarios for campaigns that are hard to learn: errors slower than a window, several at once, what no error model can
say, wrong descriptions, short missions; and a slow error of DVL, fixes and depth.
"""

from __future__ import annotations

import math

from navfilter.models.error_models import ErrorModel, GaussMarkov, White
from navfilter.models.vehicle import Vehicle
from navfilter.simulation.studies import Study, always, believing, compass, swing, with_sensor

_DEG = math.pi / 180.0


def _slow(sd: float, tau_s: float, white: float, order: int = 1) -> ErrorModel:
    return GaussMarkov(sd=sd, tau_s=tau_s, order=order) + White(sd=white)


def _slow_deg(sd: float, tau_s: float, white: float, order: int = 1) -> ErrorModel:
    return _slow(sd * _DEG, tau_s, white * _DEG, order)


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
        always((_slow(0.02, 120.0, 0.01), _slow(0.02, 120.0, 0.01), _slow(0.005, 120.0, 0.01))),
        believing(dvl=_slow(0.01, 60.0, 0.01)),
        misled=True,
    ),
    "gps-slow": Study(
        "fixes slow, 2 m, 200 s, on white noise of 0.5 m; half of the way at the surface",
        "gps",
        "smooth",
        always(_slow(2.0, 200.0, 0.5)),
        believing(gps=_slow(3.0, 60.0, 0.5)),
        fixes_s=900.0,
    ),
    "depth-slow": Study(
        "depth slow, 0.3 m, 200 s, on white noise of 5 cm",
        "depth",
        "smooth",
        always(_slow(0.3, 200.0, 0.05)),
        believing(depth=_slow(0.1, 60.0, 0.05)),
        misled=True,
    ),
}
