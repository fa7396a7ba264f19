"""Missions by name: a vehicle, a motion that fills a given time, and what goes wrong on the way."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from navfilter.models.error_models import Arma, ErrorModel, GaussMarkov, White, per_axis
from navfilter.models.mechanisation import DeadReckoning
from navfilter.models.mission import Mission
from navfilter.models.sensors import BodyVelocity, Depth, Heading, Position, WaterVelocity
from navfilter.models.vehicle import Vehicle
from navfilter.simulation import presets
from navfilter.simulation.faults import Changing, Faults
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
from navfilter.simulation.simulate import StartErrors, simulate

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
