"""Missions by name: a vehicle, a motion that fills a given time, and what goes wrong on the way.

Scenarios for Monte Carlo campaigns: one sensor errs in a known way, its operator believes something simpler.

Every scenario comes on two motions (lawnmower and straight transit) and with two gyros (tactical and micromechanical),
and all of them with three losses of the DVL, outliers of compass, DVL and GPS, fixes at the surface only, and a
surfacing at the end.

How one sensor errs in a campaign, and what its operator believes: the usual errors, those of the thesis among
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

from navfilter.models.error_models import Arma, ErrorModel, GaussMarkov, RandomWalk, White, per_axis
from navfilter.models.mechanisation import DeadReckoning
from navfilter.models.mission import Mission
from navfilter.models.sensors import BodyVelocity, Depth, Heading, Position, WaterVelocity
from navfilter.models.vehicle import Vehicle
from navfilter.simulation import presets
from navfilter.simulation.manoeuvres import (
    ChangeSpeed,
    Dive,
    FigureEight,
    Lawnmower,
    Manoeuvre,
    SpiralDive,
    Straight,
    Surface,
    Turn,
    Wait,
)
from navfilter.simulation.motion import Motion, Wander
from navfilter.simulation.simulate import Changing, Faults, Models, StartErrors, simulate

_DEG = math.pi / 180.0
COMPASS = GaussMarkov(sd=0.6 * _DEG, tau_s=30.0)
_Pattern = Callable[[int], tuple[Manoeuvre, ...]]
# off Fort Lauderdale, where the vehicles of the thesis dived
_PLACE = {"latitude_deg": 26.05, "longitude_deg": -80.1}


@dataclass(frozen=True)
class Scenario:
    """A simulated mission that has a name.

    Parameters
    ----------
    about : str
        One line for listings.
    vehicle : callable
        Returns the Vehicle.
    motion : callable
        Takes a duration in s, returns a Motion at least that long.
    faults : callable
        Takes a duration in s, returns the faults by sensor.
    duration_s : float
        When nothing else is asked for, s.
    start : StartErrors
        How well the start is known.
    """

    about: str
    vehicle: Callable[[], Vehicle]
    motion: Callable[[float], Motion]
    faults: Callable[[float], dict[str, Faults]] = field(default=lambda duration_s: {})
    duration_s: float = 600.0
    start: StartErrors = field(default_factory=StartErrors)


def simulate_scenario(name: str, seed: int, duration_s: float | None = None) -> tuple[Vehicle, Mission]:
    """Simulate one of the `SCENARIOS`.

    Parameters
    ----------
    name : str
        Key of `SCENARIOS`.
    seed : int
    duration_s : float, optional
        Default: that of the scenario.

    Returns
    -------
    vehicle : Vehicle
        As its operator describes it.
    mission : Mission
        With truth and start.

    Raises
    ------
    ValueError
        For an unknown name.
    """
    if name not in SCENARIOS:
        raise ValueError(f'There is no scenario "{name}". Scenarios: {", ".join(SCENARIOS)}.')
    scenario = SCENARIOS[name]
    duration = scenario.duration_s if duration_s is None else float(duration_s)
    if not duration > 0.0:
        raise ValueError(f"duration_s must be positive, found {duration}.")
    vehicle = scenario.vehicle()
    mission = simulate(
        vehicle,
        scenario.motion(duration),
        seed=seed,
        duration_s=duration,
        faults=scenario.faults(duration),
        start=scenario.start,
        name=f"{name}-{seed}",
    )
    return vehicle, mission


def survey_vehicle(*, mems: bool = False) -> Vehicle:
    """AUV with an inertial unit (tactical or micromechanical), compass, DVL, depth gauge and satellite receiver."""
    return Vehicle(
        imu=presets.mems_imu() if mems else presets.tactical_imu(),
        sensors={
            "compass": Heading(rate_hz=8.0, error=COMPASS),
            "dvl": BodyVelocity(rate_hz=4.0, error=White(sd=0.01), lever_arm_b_m=(0.5, 0.0, 0.1)),
            "depth": Depth(rate_hz=1.0, error=White(sd=0.05), lever_arm_b_m=(0.2, 0.0, -0.1)),
            "gps": Position(rate_hz=1.0, error=GaussMarkov(sd=3.0, tau_s=60.0), lever_arm_b_m=(-0.4, 0.0, -0.2)),
        },
        name="survey-mems" if mems else "survey",
    )


def reckoning_vehicle() -> Vehicle:
    """The same AUV without an inertial unit: its compass and its DVL carry the position."""
    return Vehicle(
        DeadReckoning(
            rate_hz=4.0,
            attitude=Heading(rate_hz=4.0, error=COMPASS),
            velocity=BodyVelocity(rate_hz=4.0, error=White(sd=0.01), lever_arm_b_m=(0.5, 0.0, 0.1)),
            tilt=GaussMarkov(sd=0.2 * _DEG, tau_s=5.0),
        ),
        sensors={
            "depth": Depth(rate_hz=1.0, error=White(sd=0.05)),
            "gps": Position(rate_hz=1.0, error=GaussMarkov(sd=3.0, tau_s=60.0)),
        },
        name="reckoning",
    )


def thesis_vehicle() -> Vehicle:
    """The vehicle of the thesis's Table 2.1, with a depth gauge."""
    return Vehicle(
        imu=presets.crossbow_imu(),
        sensors={
            "compass": presets.tcm2_compass(),
            "dvl": presets.rdi_dvl(),
            "depth": presets.pressure_depth(),
            "gps": presets.motorola_gps(),
        },
        name="thesis",
    )


def water_track_vehicle() -> Vehicle:
    """The survey's AUV whose DVL tracks the water too, in a current that lasts for hours."""
    plain = survey_vehicle()
    water = WaterVelocity(rate_hz=4.0, lever_arm_b_m=(0.5, 0.0, 0.1), current_sd_m_s=0.1, current_tau_s=6.0 * 3600.0)
    return Vehicle(plain.drive, {**plain.sensors, "water": water}, name="water-track")


def survey(duration_s: float, surface_s: float = 120.0, depth_m: float = 20.0, leg_m: float = 120.0) -> Motion:
    """Fixes at the surface, dive, lawnmower at depth, surfacing and fixes again, to fill the duration."""
    return dive(duration_s, lambda legs: (Lawnmower(legs, leg_m),), (surface_s, surface_s), depth_m)


def lawnmower(duration_s: float) -> Motion:
    """The survey with less time at the surface, shallower and with shorter legs: turns fill a third of it."""
    return survey(duration_s, surface_s=45.0, depth_m=10.0, leg_m=60.0)


def transit(duration_s: float) -> Motion:
    """As `lawnmower`, but straight on at depth."""
    return dive(duration_s, None, (45.0, 45.0), 10.0)


def turns_and_dives(duration_s: float) -> Motion:
    """Figure-eights, spiral dives and climbs, one after the other."""
    cycle = (FigureEight(rate_deg_s=6.0), SpiralDive(20.0), Straight(duration_s=15.0), Dive(10.0), Turn(120.0))
    begin = (Wait(20.0), ChangeSpeed(1.5, 15.0), Straight(duration_s=45.0), Dive(10.0))
    end = (Surface(), Straight(duration_s=45.0), ChangeSpeed(0.0, 15.0), Wait(20.0))
    return _fill(duration_s, begin, lambda times: cycle * times, end)


def dive(
    duration_s: float, pattern: _Pattern | None, surface_s: tuple[float, float], depth_m: float, rest_s: float = 20.0
) -> Motion:
    """Rest, fixes at the surface, dive, the pattern as often as it fits (or straight on), surfacing, fixes, rest.

    Parameters
    ----------
    duration_s : float
        To be filled, s.
    pattern : callable or None
        Takes a number of repetitions, returns manoeuvres.
    surface_s : tuple of (float, float)
        Way at the surface before and after the dive, s.
    depth_m : float
        Of the dive, m.
    rest_s : float
        At rest before the start, s.

    Returns
    -------
    Motion
        At least that long.
    """
    begin = (Wait(rest_s), ChangeSpeed(1.5, 15.0), Straight(duration_s=surface_s[0]), Dive(depth_m))
    end = (Surface(), Straight(duration_s=surface_s[1]), ChangeSpeed(0.0, 15.0), Wait(20.0))
    return _fill(duration_s, begin, pattern, end)


def _fill(
    duration_s: float, begin: tuple[Manoeuvre, ...], pattern: _Pattern | None, end: tuple[Manoeuvre, ...]
) -> Motion:
    """A motion of this duration (or longer): as many repetitions of the pattern as fit, the rest straight on."""

    def build(repeats: int, straight_s: float = 0.0) -> Motion:
        middle = pattern(repeats) if pattern is not None and repeats else ()
        rest = (Straight(duration_s=straight_s),) if straight_s > 0.0 else ()
        return Motion((*begin, *middle, *rest, *end), heading_deg=40.0, wander=Wander(), **_PLACE)

    repeats = 0
    if pattern is not None and duration_s >= build(1).duration_s:
        one, two = build(1).duration_s, build(2).duration_s
        repeats = 1 + int((duration_s - one) / (two - one))
    return build(repeats, max(duration_s - build(repeats).duration_s, 0.0))


def _gps_at_surface(duration_s: float) -> dict[str, Faults]:
    return {"gps": Faults(available="surface")}


def _bottom_lost(duration_s: float) -> dict[str, Faults]:
    """Its middle third over water too deep for bottom track."""
    return {**_gps_at_surface(duration_s), "dvl": Faults(dropouts=((duration_s / 3.0, duration_s / 1.5),))}


def _swinging_compass() -> ErrorModel:
    """A slow error and an oscillation of 6 s, together an ARMA(3, 2) at 8 Hz."""
    angle, radius = 2.0 * math.pi / (6.0 * 8.0), 0.99
    ar = (-2.0 * radius * math.cos(angle), radius**2)
    return GaussMarkov(0.35 * _DEG, tau_s=60.0) + Arma(ar=ar, sd=0.35 * _DEG / _gain(ar))


def _oscillating(duration_s: float) -> dict[str, Faults]:
    return {**_gps_at_surface(duration_s), "compass": Faults(true_error=_swinging_compass())}


def _oscillating_vehicle() -> Vehicle:
    """Believes in the Gauss-Markov process that goes through the 1/e point of that autocorrelation."""
    return survey_vehicle().with_error(compass=GaussMarkov(sd=0.5 * _DEG, tau_s=1.75))


def _demo_vehicle() -> Vehicle:
    """Believes its compass as a data sheet puts it, accurate to a degree, and knows that it deviates with the heading;
    really its error is slow, too.
    """
    plain = survey_vehicle()
    compass = Heading(
        rate_hz=8.0, error=White(sd=1.0 * _DEG), bias_sd_rad=0.5 * _DEG, deviation_sd_rad=(1.0 * _DEG, 0.0)
    )
    return Vehicle(plain.drive, {**plain.sensors, "compass": compass}, name=plain.name)


def _demo_faults(duration_s: float) -> dict[str, Faults]:
    lost = tuple(
        (share * duration_s, share * duration_s + long_s) for share, long_s in ((0.3, 60.0), (0.5, 180.0), (0.7, 30.0))
    )
    return {
        "gps": Faults(available="surface", outlier_probability=0.01, outlier_sd=50.0),
        "dvl": Faults(dropouts=lost, outlier_probability=0.005, outlier_sd=0.5, quantisation=1e-3),
        "compass": Faults(
            GaussMarkov(sd=1.0 * _DEG, tau_s=300.0) + White(sd=0.5 * _DEG),
            deviation_rad=(0.0, 0.6 * _DEG, 0.8 * _DEG, 0.0, 0.0),
            quantisation=0.1 * _DEG,
            outlier_probability=0.002,
            outlier_sd=20.0 * _DEG,
        ),
        "depth": Faults(quantisation=0.01),
    }


def _gain(ar: tuple[float, float]) -> float:
    """Standard deviation of an AR(2) process driven by unit white noise (Box & Jenkins, 1976, eq 3.2.28)."""
    a1, a2 = ar
    return math.sqrt((1.0 + a2) / ((1.0 - a2) * ((1.0 + a2) ** 2 - a1**2)))


def _changing(duration_s: float) -> dict[str, Faults]:
    later = GaussMarkov(sd=1.8 * _DEG, tau_s=30.0)
    return {
        **_gps_at_surface(duration_s),
        "compass": Faults(true_error=Changing(((0.0, COMPASS), (duration_s / 2.0, later)))),
    }


def _miscalibrated_vehicle() -> Vehicle:
    """The survey's AUV with transponder fixes all along, and sure of its constants."""
    plain = survey_vehicle()
    usbl = Position(rate_hz=1.0, error=GaussMarkov(sd=0.4, tau_s=10.0) + White(sd=0.2), lever_arm_b_m=(-0.4, 0.0, -0.2))
    kept = {name: sensor for name, sensor in plain.sensors.items() if name != "gps"}
    return Vehicle(plain.drive, {**kept, "usbl": usbl}, name="miscalibrated")


def _miscalibrated(duration_s: float) -> dict[str, Faults]:
    """By 0.3 s, 0.5 m, 2 % and 3 deg; its compass deviates by 2 deg."""
    return {
        "dvl": Faults(
            scale=0.02, misalignment_rad=(0.0, 0.0, 3.0 * _DEG), lever_arm_m=(0.5, 0.0, 0.0), time_offset_s=0.3
        ),
        "compass": Faults(deviation_rad=(0.0, 2.0 * _DEG, 0.0, 0.0, 0.0)),
    }


def _two_units() -> Vehicle:
    plain = survey_vehicle()
    return Vehicle(imus=dict.fromkeys("ab", plain.units["imu"]), sensors=plain.sensors, name="two-units")


def _one_silent(duration_s: float) -> dict[str, Faults]:
    """The first unit says nothing for twenty seconds of its dive."""
    return {**_gps_at_surface(duration_s), "a": Faults(dropouts=((0.5 * duration_s, 0.5 * duration_s + 20.0),))}


#: The scenarios by name.
SCENARIOS: dict[str, Scenario] = {
    "demo": Scenario(
        "one hour: fixes, dive, lawnmower, outliers, a DVL lost for minutes, a compass that errs slowly, surfacing",
        _demo_vehicle, survey, _demo_faults, 3600.0, StartErrors(position_sd_m=(3.0, 3.0, 0.5), heading_sd_deg=2.0),
    ),
    "lawnmower": Scenario("fixes, dive, lawnmower, surfacing, fixes", survey_vehicle, lawnmower, _gps_at_surface),
    "transit": Scenario("fixes, dive, straight transit, surfacing, fixes", survey_vehicle, transit, _gps_at_surface),
    "turns": Scenario("figure-eights, spiral dives and climbs", survey_vehicle, turns_and_dives, _gps_at_surface),
    "mems": Scenario("the same lawnmower with a micromechanical inertial unit",
                     lambda: survey_vehicle(mems=True), lawnmower, _gps_at_surface),
    "reckoning": Scenario("the same lawnmower without an inertial unit", reckoning_vehicle, lawnmower, _gps_at_surface),
    "thesis": Scenario("survey with the instruments of the thesis", thesis_vehicle, survey, _gps_at_surface, 1800.0),
    "oscillating": Scenario("lawnmower; the compass errs slowly and swings, the vehicle believes in Gauss-Markov",
                            _oscillating_vehicle, lawnmower, _oscillating, 1800.0),
    "changing": Scenario("lawnmower; the error of the compass trebles half-way",
                         survey_vehicle, lawnmower, _changing, 1800.0),
    "water-track": Scenario("survey; the DVL loses the bottom for its middle third, but tracks the water",
                            water_track_vehicle, survey, _bottom_lost, 1800.0),
    "miscalibrated": Scenario("turns and dives with fixes; DVL off by 0.3 s, 0.5 m, 2 % and 3 deg, compass by 2 deg",
                              _miscalibrated_vehicle, turns_and_dives, _miscalibrated),
    "two-units": Scenario("the same lawnmower with two inertial units, one of which falls silent for 20 s",
                          _two_units, lawnmower, _one_silent),
}  # fmt: skip


# --- what is really the matter ---------------------------------------------------------------------------------------


def true_vehicle(name: str, duration_s: float | None = None) -> Vehicle | None:
    """The vehicle of a scenario as it really is.

    Parameters
    ----------
    name : str
        Key of `navfilter.simulation.scenarios.SCENARIOS`.
    duration_s : float, optional
        As for `simulate_scenario`.

    Returns
    -------
    Vehicle or None
        With the true error models of the sensors, rounding as white noise of its step over sqrt(12) beside them (Widrow
        & Kollar, 2008, sec. 1.2). None where the description is the truth. An error that changes during the mission is
        no model; such a sensor keeps the description's.

    Raises
    ------
    ValueError
        For an unknown name.

    Examples
    --------
    >>> type(true_vehicle("oscillating").sensors["compass"].error).__name__, true_vehicle("lawnmower")
    ('Sum', None)
    """
    if name not in SCENARIOS:
        raise ValueError(f'There is no scenario "{name}". Scenarios: {", ".join(SCENARIOS)}.')
    scenario = SCENARIOS[name]
    vehicle = scenario.vehicle()
    models: dict[str, ErrorModel | tuple[ErrorModel, ...]] = {}
    for key, fault in scenario.faults(scenario.duration_s if duration_s is None else duration_s).items():
        if fault.true_error is not None and not isinstance(fault.true_error, Changing):
            axes = vehicle.sensors[key].axes if key in vehicle.sensors else 3
            each = tuple(_rounded(model, fault) for model in per_axis(fault.true_error, axes, key))
            models[key] = each if len(each) > 1 else each[0]
    return vehicle.with_error(**models) if models else None


def _rounded(model: ErrorModel, fault: Faults) -> ErrorModel:
    step = fault.quantisation if isinstance(fault.quantisation, float | int) else max(fault.quantisation)
    if not step:
        return model
    return model + White(sd=step / math.sqrt(12.0))


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
        Further faults of the sensor, as `navfilter.simulation.simulate.Faults` takes them.
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


MOTIONS = ("lawnmower", "transit")
GYROS = ("tactical", "mems")
#: Readings that a learner looks at before its first model is judged.
WINDOW = 4000

#: The scenarios of campaigns by name.
STUDIES: dict[str, Study] = USUAL | HARD


@dataclass(frozen=True)
class Staged:
    """A scenario made ready: draw as many missions from it as there are seeds.

    Attributes
    ----------
    name : str
        Of the scenario, with motion and gyro.
    study : Study
    vehicle : Vehicle
        As its operator describes it.
    real : Vehicle
        As it is, but for the errors in `faults`.
    motion : Motion
    faults : dict of str to Faults
    truth : dict of str to error models, or None
        What is really the matter with the sensor under study, as near as a model can say it; None where it changes
        during the mission.
    duration_s : float
    """

    name: str
    study: Study
    vehicle: Vehicle
    real: Vehicle
    motion: Motion
    faults: dict[str, Faults]
    truth: dict[str, Models] | None
    duration_s: float

    @property
    def learnt(self) -> str:
        """The correcting sensor that a learner works on: the one under study, or the compass where that is the gyro."""
        return self.study.sensor if self.study.sensor in self.vehicle.sensors else "compass"

    @property
    def window_s(self) -> float:
        """Duration of the learner's first window [s]."""
        return WINDOW / self.vehicle.sensors[self.learnt].rate_hz

    @property
    def oracle(self) -> Vehicle | None:
        """The vehicle whose operator knows the truth; None where it changes during the mission."""
        return None if self.truth is None else self.real.with_error(**self.truth)  # type: ignore[arg-type]

    @property
    def changes_s(self) -> float | None:
        """When the error changes [s]."""
        error = self.faults[self.study.sensor].true_error
        return error.steps[1][0] if isinstance(error, Changing) and len(error.steps) > 1 else None

    def mission(self, seed: int) -> Mission:
        """Simulate the mission of one seed, with its truth."""
        how = {"duration_s": self.duration_s, "faults": self.faults, "start": StartErrors(), "truth_rate_hz": 5.0}
        return simulate(self.real, self.motion, seed=seed, name=f"{self.name}/{seed}", **how)  # type: ignore[arg-type]


def stage(
    name: str,
    *,
    motion: str = "lawnmower",
    gyro: str = "tactical",
    duration_s: float | None = None,
    imu_rate_hz: float = 100.0,
) -> Staged:
    """Make a scenario ready.

    Parameters
    ----------
    name : str
        Key of `STUDIES`; motion and gyro may follow: "compass-gm2/transit/mems".
    motion : "lawnmower" or "transit"
    gyro : "tactical" or "mems"
    duration_s : float, optional
        Default: that of the scenario.
    imu_rate_hz : float
        50 Hz halves the time it takes to simulate a mission; the vehicle described has the same unit.

    Returns
    -------
    Staged

    Raises
    ------
    ValueError
        For unknown names, and rates or durations that are not positive.

    Examples
    --------
    >>> staged = stage("compass-gm2/transit", duration_s=600.0)
    >>> staged.name, staged.study.kind, staged.truth
    ('compass-gm2/transit/tactical', 'smooth', {'compass': GaussMarkov(sd=0.008726646259971648, tau_s=10.0, order=2)})
    """
    key, *more = name.split("/")
    if key not in STUDIES:
        raise ValueError(f'There is no scenario "{key}" for campaigns. Scenarios: {", ".join(STUDIES)}.')
    for word in more:
        motion, gyro = (word, gyro) if word in MOTIONS else (motion, word)
    for value, known, what in ((motion, MOTIONS, "motion"), (gyro, GYROS, "gyro")):
        if value not in known:
            raise ValueError(f'The {what} must be one of {", ".join(known)}, found "{value}".')
    study = STUDIES[key]
    duration = study.duration_s if duration_s is None else float(duration_s)
    if not (duration > 0.0 and imu_rate_hz > 0.0):
        raise ValueError(f"Duration and rate must be positive, found {duration} s and {imu_rate_hz} Hz.")
    plain = survey_vehicle(mems=gyro == "mems")
    drive = replace(plain.drive, rate_hz=float(imu_rate_hz))
    vehicle = study.equip(Vehicle(drive, dict(plain.sensors), plain.name).with_error(compass=BELIEF))
    error = study.error(vehicle, duration)
    faults = _faults(duration, study, error)
    truth = None if isinstance(error, Changing) else {study.sensor: error if study.told is None else study.told}
    course, real = _motion(motion, duration, study), study.really(vehicle)
    return Staged(f"{key}/{motion}/{gyro}", study, vehicle, real, course, faults, truth, duration)


def _motion(name: str, duration_s: float, study: Study) -> Motion:
    """Shallow, with short legs: turns fill a third of the lawnmower."""
    pattern = None if name == "transit" else lambda legs: (Lawnmower(legs, study.leg_m),)
    return dive(duration_s, pattern, (study.fixes_s, 45.0), 10.0, study.rest_s)


def _faults(duration_s: float, study: Study, error: Models | Changing) -> dict[str, Faults]:
    """DVL losses of 30, 60 and 15 s (less in a short mission), outliers, fixes at the surface only.

    Longer losses would leave errors of position that drown those of the heading: 2 minutes on inertia cost 40 m.
    """
    short = min(1.0, duration_s / 1800.0)
    lost = tuple(
        (share * duration_s, share * duration_s + short * long_s)
        for share, long_s in ((0.3, 30.0), (0.5, 60.0), (0.7, 15.0))
    )
    faults = {
        "gps": Faults(available="surface", outlier_probability=0.01, outlier_sd=50.0),
        "dvl": Faults(dropouts=lost, outlier_probability=0.005, outlier_sd=0.5),
        "compass": Faults(outlier_probability=0.002, outlier_sd=20.0 * _DEG),
        "gyro": Faults(),
    }
    sensor = study.sensor
    faults[sensor] = replace(faults.get(sensor, Faults()), true_error=error, **study.faulty)
    return faults
