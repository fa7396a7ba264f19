"""Simulated missions: exact motion, seen by the sensors of a vehicle with all their errors, recorded with the truth.

The motion is given and every error is drawn here.

How a simulated sensor really errs: noise drawn from error models, and faults that its description does not mention.

Every random number comes from a generator that belongs to one stream and one purpose, derived from the mission's seed
and their names. Adding a sensor, or a fault to one sensor, changes nothing in the noise of the others; a longer mission
begins with the noise of the shorter one.
"""

import dataclasses
import datetime
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from types import MappingProxyType

import numpy as np
import scipy  # its parts are imported when they are first used: that takes a second
from scipy.linalg import schur
from scipy.spatial.transform import Rotation

from navfilter.foundation.arguments import within
from navfilter.foundation.arrays import Array, ArrayLike
from navfilter.models.error_models import ErrorModel, White, per_axis
from navfilter.models.mechanisation import CROSSED, DeadReckoning, Imu, Mechanisation
from navfilter.models.mission import TRUTH_COLUMNS, Mission, Stream
from navfilter.models.parameters import Calibrated, Parameter, with_calibrated
from navfilter.models.sensors import BodyVelocity, Heading, Sensor
from navfilter.models.sensors.traits import kinds_below, shown_unit
from navfilter.models.start import Start
from navfilter.models.truth import Kinematics, Truth, attitude
from navfilter.models.vehicle import Vehicle
from navfilter.simulation.manoeuvres import ChangeSpeed, Wait
from navfilter.simulation.motion import Motion

Interval = tuple[float, float]
Models = ErrorModel | Sequence[ErrorModel]

DROPOUT_READINGS = ("missing", "nan", "zero")


@dataclass(frozen=True)
class Changing:
    """An error that changes during the mission: from each time on, another model.

    Parameters
    ----------
    steps : tuple of (float, ErrorModel or tuple of ErrorModel)
        Time from which each model holds, s, increasing; the first must begin at 0.

    Examples
    --------
    >>> from navfilter.models.error_models import White
    >>> Changing(((0.0, White(sd=0.5)), (1800.0, White(sd=1.5)))).steps[1][0]
    1800.0
    """

    steps: tuple[tuple[float, Models], ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "steps", tuple(self.steps))
        times = [from_s for from_s, _ in self.steps]
        if not times or times[0] != 0.0 or any(b <= a for a, b in pairwise(times)):
            raise ValueError(f"Changing needs increasing times that begin at 0, found {times}.")


@dataclass(frozen=True)
class Faults:
    """How one sensor of a simulated vehicle departs from its description.

    Errors are in the unit of the error model (SI, radians; metres north, east, down for a position). Calibration that
    is left at None is drawn from the uncertainty that the vehicle's description states, so that an honest filter
    stays honest.

    Parameters
    ----------
    true_error : ErrorModel, tuple of ErrorModel (one per axis) or Changing, optional
        What the sensor really does, where it differs from what the vehicle believes.
    bias : float or tuple of float
        Constant added to the error.
    scale : float or tuple of float, optional
        Scale error: the reading is (1 + scale) times what it should be; of each axis where the sensor has one for each.
    misalignment_rad : tuple of 3 floats, optional
        Rotation vector of the measured vector relative to what it should be, rad.
    lever_arm_m : tuple of 3 floats, optional
        By how much the sensor is elsewhere than its description says, m.
    deviation_rad : tuple of 5 floats, optional
        Compass: bias, sine and cosine of the heading, sine and cosine of twice the heading, rad.
    temperature_rad_per_k : float, optional
        Compass: drift with temperature, rad/K.
    current_m_s : tuple of 2 floats, optional
        Velocity through the water: a steady current, north and east, m/s. At None it is drawn as the description states
        it, and wanders.
    available : "always", "surface" or tuple of (float, float)
        When there are readings: always, at the surface only, or within intervals of time, s.
    dropouts : tuple of (float, float)
        Intervals without valid readings, s.
    dropout_reading : "missing", "nan" or "zero"
        What is recorded in a dropout: nothing, NaN, or zeros that look valid.
    outlier_probability, outlier_sd : float
        A reading is off by a further normal error of this size, with this probability.
    quantisation : float or tuple of float
        Step to which readings are rounded, in the unit of the reading, per column if it is a tuple; 0 is not rounded.
    time_offset_s, time_jitter_sd_s : float
        The time stamp is late by the offset and a random part, s.
    hdop : float or tuple of (float, float), optional
        Position: dilution of precision reported with the fix, constant or as steps (from time in s, value).
    """

    true_error: Models | Changing | None = None
    bias: float | tuple[float, ...] = 0.0
    scale: float | tuple[float, ...] | None = None
    misalignment_rad: tuple[float, float, float] | None = None
    lever_arm_m: tuple[float, float, float] | None = None
    deviation_rad: tuple[float, float, float, float, float] | None = None
    temperature_rad_per_k: float | None = None
    current_m_s: tuple[float, float] | None = None
    available: str | tuple[Interval, ...] = "always"
    dropouts: tuple[Interval, ...] = ()
    dropout_reading: str = "missing"
    outlier_probability: float = 0.0
    outlier_sd: float = 0.0
    quantisation: float | tuple[float, ...] = 0.0
    time_offset_s: float = 0.0
    time_jitter_sd_s: float = 0.0
    hdop: float | tuple[tuple[float, float], ...] | None = None

    def __post_init__(self) -> None:
        if self.dropout_reading not in DROPOUT_READINGS:
            raise ValueError(f'dropout_reading must be one of {DROPOUT_READINGS}, found "{self.dropout_reading}".')
        if isinstance(self.available, str) and self.available not in ("always", "surface"):
            raise ValueError(f'available must be "always", "surface" or intervals, found "{self.available}".')
        if not 0.0 <= self.outlier_probability <= 1.0:
            raise ValueError(f"outlier_probability must lie between 0 and 1, found {self.outlier_probability}.")
        for begin, end in (*self.dropouts, *(() if isinstance(self.available, str) else self.available)):
            if not begin <= end:
                raise ValueError(f"An interval must not end before it begins, found ({begin}, {end}).")


def generator(seed: int, stream: str, purpose: str) -> np.random.Generator:
    """The generator that belongs to one stream and one purpose of a mission.

    Examples
    --------
    >>> a, b = (generator(1, name, "error").normal() for name in ("dvl", "gps"))
    >>> a == b, a == generator(1, "dvl", "error").normal()
    (False, True)
    """
    if seed < 0:
        raise ValueError(f"seed must not be negative, found {seed}.")
    # the zero byte keeps ("ab", "c") apart from ("a", "bc")
    return np.random.default_rng(np.random.SeedSequence([seed, *f"{stream}\0{purpose}".encode()]))


def draw_error(model: ErrorModel, period_s: float, n: int, seed: int, stream: str, axis: int = 0) -> Array:
    """Draw the error of one axis, tick by tick of its sensor's clock, from the stationary (or stated) start.

    The block's recursion is brought to triangular form (complex Schur), where each state is one first-order recursive
    filter: an hour at 100 Hz takes some hundredths of a second.

    Parameters
    ----------
    model : ErrorModel
    period_s : float
        Period of the sensor, s.
    n : int
        Number of ticks.
    seed, stream, axis
        Which generator.

    Returns
    -------
    ndarray, shape (n,)
    """
    block = model.block(period_s)
    error = math.sqrt(block.r) * generator(seed, stream, f"white {axis}").normal(size=n)
    size = len(block.C)
    if size == 0 or n == 0:
        return error
    start = _factor(block.P0) @ generator(seed, stream, f"start {axis}").normal(size=size)
    drive = generator(seed, stream, f"drive {axis}").normal(size=(n, size)) @ _factor(block.Q).T
    T, Z = schur(block.Phi, output="complex")
    state = np.zeros((n, size), dtype=np.complex128)
    shifted = np.vstack([start, drive[:-1]]) @ Z.conj()
    for k in range(size - 1, -1, -1):
        shifted[1:, k] += state[:-1, k + 1 :] @ T[k, k + 1 :]
        state[:, k] = scipy.signal.lfilter([1.0], [1.0, -T[k, k]], shifted[:, k])
    return error + (state @ (block.C @ Z)).real


def draw_errors(models: Models | Changing, period_s: float, time_s: Array, axes: int, seed: int, stream: str) -> Array:
    """Draw the errors of all axes of a sensor at consecutive ticks (n,); returns (n, axes)."""
    steps = models.steps if isinstance(models, Changing) else ((0.0, models),)
    errors = np.zeros((time_s.size, axes))
    for from_s, step in steps:
        rows = time_s >= from_s
        for axis, model in enumerate(per_axis(step, axes, stream)):
            errors[rows, axis] = draw_error(model, period_s, time_s.size, seed, stream, axis)[rows]
    return errors


def outliers(faults: Faults, n: int, axes: int, seed: int, stream: str) -> Array:
    """Further errors (n, axes) of the readings that are outliers, zero for the others."""
    if faults.outlier_probability == 0.0:
        return np.zeros((n, axes))
    hit = generator(seed, stream, "outlier").random(n) < faults.outlier_probability
    size = generator(seed, stream, "outlier size").normal(scale=faults.outlier_sd, size=(n, axes))
    return np.where(hit[:, None], size, 0.0)


def quantise(value: Array, step: float | tuple[float, ...]) -> Array:
    """Values (n, axes) rounded to multiples of the step, per axis if it is a tuple; a step of 0 leaves them."""
    steps = np.broadcast_to(np.asarray(step, dtype=np.float64), value.shape[1:])
    safe = np.where(steps > 0.0, steps, 1.0)
    return np.where(steps > 0.0, np.round(value / safe) * safe, value)


def _factor(P: Array) -> Array:
    """A factor L with L L' = P; P may be singular. Fixed signs: another LAPACK, same noise."""
    value, vector = np.linalg.eigh(P)
    largest = vector[np.abs(vector).argmax(axis=0), np.arange(len(value))]
    return vector * np.where(largest < 0.0, -1.0, 1.0) * np.sqrt(np.maximum(value, 0.0))


SURFACE_DEPTH_M = 0.3  # an antenna works down to this depth


@dataclass(frozen=True)
class StartErrors:
    """Standard deviations with which the start is known; the start is drawn around the truth with them.

    Parameters
    ----------
    position_sd_m : float or tuple of 3 floats
        North, east, down, m.
    velocity_sd_m_s, tilt_sd_deg, heading_sd_deg : float
        m/s per axis; deg.
    exact : bool
        Start at the truth, while stating the standard deviations all the same.
    """

    position_sd_m: float | tuple[float, float, float] = (1.0, 1.0, 0.2)
    velocity_sd_m_s: float = 0.02
    tilt_sd_deg: float = 0.1
    heading_sd_deg: float = 1.0
    exact: bool = False


def simulate(
    vehicle: Vehicle,
    motion: Motion,
    *,
    seed: int,
    duration_s: float | None = None,
    faults: Mapping[str, Faults] | None = None,
    start: StartErrors | None = None,
    date: datetime.date = datetime.date(2026, 6, 1),
    truth_rate_hz: float = 20.0,
    name: str = "simulated",
) -> Mission:
    """Drive a vehicle through a motion and record what its sensors say.

    Parameters
    ----------
    vehicle : Vehicle
        Its sensors, with the errors its description states; what differs from it in truth is in `faults`.
    motion : Motion
        Where it really goes.
    seed : int
        Everything random follows from it, see `navfilter.simulation.simulate`.
    duration_s : float, optional
        Stop after this time, s; default the whole motion.
    faults : dict of str to Faults, optional
        By name of the sensor; "gyro" and "accel" for the error and calibration of an inertial unit (of one of several
        "a.gyro"), "imu" for its
        dropouts and time stamps; "attitude" and "velocity" for dead reckoning.
    start : StartErrors, optional
        How well the start is known.
    date : datetime.date
        For the magnetic field.
    truth_rate_hz : float
        Rate of the recorded truth, Hz.
    name : str
        Of the mission.

    Returns
    -------
    Mission
        With truth and start. The notes say which calibration errors were drawn.

    Raises
    ------
    ValueError
        If the motion is shorter than `duration_s`, or a fault names a sensor that the vehicle does not have.

    Examples
    --------
    >>> from navfilter.simulation.scenarios import simulate_scenario
    >>> vehicle, mission = simulate_scenario("lawnmower", seed=1, duration_s=60.0)
    >>> mission.truth is not None, sorted(mission.streams) == sorted(["imu", *vehicle.sensors])
    (True, True)
    """
    faults = dict(faults or {})
    _check_names(vehicle, faults)
    duration = motion.duration_s if duration_s is None else float(duration_s)
    if not 0.0 < duration <= motion.duration_s + 1e-9:
        raise ValueError(f"duration_s must lie between 0 and the motion's {motion.duration_s:.1f} s, found {duration}.")
    place = Start(latitude_deg=motion.latitude_deg, longitude_deg=motion.longitude_deg, date=date)
    vehicle = vehicle.at(place)
    scene = _Scene(motion, duration, seed, faults, date, [])
    streams = {name: _inertial(scene, unit, name, f"{name}.") for name, unit in vehicle.imus.items()}
    streams = streams or _drive_streams(scene, vehicle.drive, place)
    for key, sensor in vehicle.sensors.items():
        if not sensor.from_drive:
            streams[key] = scene.record(key, sensor, sensor.rate_hz)
    truth = _truth(motion.at(np.arange(math.floor(duration * truth_rate_hz + 1e-6) + 1) / truth_rate_hz))
    begin = _draw_start(motion.at([0.0]), start or StartErrors(), seed, date)
    return Mission(name, streams, truth, begin, date, tuple(scene.notes))


@dataclass(frozen=True)
class _Scene:
    """What all sensors of one simulated mission share."""

    motion: Motion
    duration_s: float
    seed: int
    faults: dict[str, Faults]
    date: datetime.date
    notes: list[str]

    @cached_property
    def field_n(self) -> Array:
        """Magnetic field at the start, north-east-down, microtesla."""
        from pygeomag import GeoMag  # its tables take a while to load

        day = datetime.datetime.combine(self.date, datetime.time())
        year = day.year + (day.timetuple().tm_yday - 1) / 365.25
        field = GeoMag(base_year=day).calculate(self.motion.latitude_deg, self.motion.longitude_deg, 0.0, year)
        return np.array([field.x, field.y, field.z]) * 1e-3

    def fault(self, name: str) -> Faults:
        return self.faults.get(name, _NO_FAULTS)

    def ticks(self, rate_hz: float) -> Array:
        return np.arange(math.floor(self.duration_s * rate_hz + 1e-6) + 1) / rate_hz

    def error(self, name: str, models: Models, rate_hz: float, time_s: Array, axes: int) -> Array:
        """What is added to the readings at these ticks, (n, axes): error, outliers, bias."""
        fault = self.fault(name)
        really = models if fault.true_error is None else fault.true_error
        error = draw_errors(really, 1.0 / rate_hz, time_s, axes, self.seed, name)
        return error + outliers(fault, time_s.size, axes, self.seed, name) + np.asarray(fault.bias)

    def calibration(
        self, name: str, what: str, given: ArrayLike | None, sd: ArrayLike, size: int, mean: ArrayLike = 0.0
    ) -> Array:
        """A calibration error (size,): as given, or drawn with the mean and the standard deviation that the description
        states.
        """
        if given is not None:
            return np.array(np.broadcast_to(given, (size,)), dtype=np.float64)
        drawn = np.broadcast_to(np.asarray(sd, dtype=np.float64), (size,))
        drawn = np.asarray(mean) + drawn * generator(self.seed, name, what).normal(size=size)
        if np.any(drawn):
            self.notes.append(f"{name}: {what} error {' '.join(f'{v:.4g}' for v in drawn)}")
        return drawn

    def truth(
        self,
        name: str,
        sensor: Sensor | None,
        error: Array,
        time_s: Array,
        own: Mapping[str, tuple[Parameter, ...]] = MappingProxyType({}),
    ) -> Truth:
        """How the sensor really is; without one, a triple of a drive with calibration errors of its `own`."""
        fault = self.fault(name)
        given = {
            "scale": fault.scale,
            "misalignment": fault.misalignment_rad,
            "deviation": fault.deviation_rad,
            "temperature": fault.temperature_rad_per_k,
        }
        draws = _PLAIN | dict(own) if sensor is None else _believed(sensor.draws(), sensor.calibrated)
        drawn = {
            what: self.calibration(name, what, given.get(what), [p.sd for p in of], len(of), [p.mean for p in of])
            for what, of in draws.items()
        }
        hdop = None if fault.hdop is None else _steps(fault.hdop, time_s)
        wandering = {} if sensor is None else self.wandering(name, sensor, time_s)
        return Truth(error, drawn, lambda: self.field_n, self.motion.surface_height_m, hdop, wandering)

    def wandering(self, name: str, sensor: Sensor, time_s: Array) -> dict[str, Array]:
        """The parameters that are not constant, at these ticks: as given, or wandering as the description of the sensor
        states.
        """
        models = sensor.wandering()
        if not models:
            return {}
        what = next(iter(models))
        what = what.rsplit("_", 1)[0] if len(models) > 1 else what  # several are the components of one vector
        given = self.fault(name).current_m_s if what == "current" else None
        drawn = {}
        for axis, (key, model) in enumerate(models.items()):
            values = draw_error(model, 1.0 / sensor.rate_hz, time_s.size, self.seed, f"{name}.{what}", axis)
            drawn[key] = values if given is None else np.full(time_s.size, float(given[axis]))
        unit, factor = shown_unit(next(p.unit for p in sensor.parameters() if p.name in models))
        begin, end = (" ".join(f"{factor * values[k]:.4g}" for values in drawn.values()) for k in (0, -1))
        self.notes.append(f"{name}: {what} {begin} {unit} at the start, {end} {unit} at the end")
        return drawn

    def record(self, name: str, sensor: Sensor, rate_hz: float) -> Stream:
        """The stream of one sensor, read at this rate."""
        time_s = self.ticks(rate_hz)
        error = self.error(name, sensor.models, rate_hz, time_s, sensor.axes)
        truth = self.truth(name, sensor, error, time_s)
        late_s = self.lateness(name, sensor)
        try:
            return self.stamp(name, time_s, *self.placed(name, sensor).simulated(self.motion.at(time_s), truth), late_s)
        except ValueError as reason:
            raise ValueError(f'"{name}": {reason}') from None

    def placed(self, name: str, sensor: Sensor) -> Sensor:
        """The sensor where it really is."""
        off = self.calibration(name, "lever arm", self.fault(name).lever_arm_m, sensor.lever_arm_sd_m, 3)
        if not np.any(off):
            return sensor
        if not sensor.has_lever_arm:
            raise ValueError(f"a {type(sensor).__name__} has no lever arm.")
        arm = np.asarray(sensor.lever_arm_b_m, dtype=np.float64) + off  # type: ignore[attr-defined]
        return dataclasses.replace(sensor, lever_arm_b_m=tuple(arm.tolist()))  # type: ignore[call-arg]

    def lateness(self, name: str, sensor: Sensor | None) -> float:
        """By how much the stamps of a sensor are late [s], as its description states it."""
        if sensor is None:
            return 0.0
        off = self.calibration(name, "time offset", None, sensor.time_offset_sd_s, 1)
        return sensor.time_offset_s + float(off[0])

    def stamp(self, name: str, time_s: Array, value: Array, columns: tuple[str, ...], late_s: float = 0.0) -> Stream:
        """Round, leave out what the sensor could not read, and put the time stamps on."""
        fault = self.fault(name)
        value = quantise(value, fault.quantisation)
        if fault.available == "surface":
            keep = self.motion.surface_height_m - self.motion.at(time_s).height < SURFACE_DEPTH_M
        elif isinstance(fault.available, str):
            keep = np.ones(time_s.size, dtype=bool)
        else:
            keep = within(time_s, fault.available)
        lost = within(time_s, fault.dropouts)
        if fault.dropout_reading == "missing":
            keep &= ~lost
        else:
            value = np.where(lost[:, None], math.nan if fault.dropout_reading == "nan" else 0.0, value)
        stamps = time_s + (fault.time_offset_s + late_s)
        if fault.time_jitter_sd_s > 0.0:
            stamps += fault.time_jitter_sd_s * generator(self.seed, name, "jitter").normal(size=stamps.size)
        order = np.argsort(stamps[keep], kind="stable")
        return Stream(stamps[keep][order], value[keep][order], columns)


_NO_FAULTS = Faults()
#: Calibration errors of a triple of a drive: none is drawn, but faults may give them.
_ZERO = Parameter("", 0.0, "1")
_PLAIN = {"scale": (_ZERO,), "misalignment": (_ZERO,) * 3, "deviation": (_ZERO,) * 5}
_RECORDING = ("available", "dropouts", "time_offset_s", "time_jitter_sd_s")
_ERRORS = ("true_error", "bias", "scale", "misalignment_rad", "outlier_probability", "quantisation")


def _check_names(vehicle: Vehicle, faults: dict[str, Faults]) -> None:
    drive = {*vehicle.drive.triples, *vehicle.drive.streams}
    if vehicle.imus:
        drive = {key for name in vehicle.imus for key in (name, f"{name}.gyro", f"{name}.accel")}
    unknown = sorted(set(faults) - set(vehicle.sensors) - drive)
    if unknown:
        known = ", ".join(sorted(set(vehicle.sensors) | drive))
        raise ValueError(f'The vehicle has no sensor "{unknown[0]}" that could have faults. It has: {known}.')
    names = [(unit, name) for unit in vehicle.units or ["imu"] for name in ("gyro", "accel", unit)]
    for unit, name in names:
        # each fault has one place: what is measured belongs to gyro and accel, when it is recorded to imu
        before = f"{unit}." if vehicle.imus else ""
        given, plain = faults.get(name if name == unit else before + name, _NO_FAULTS), _NO_FAULTS
        keys = _ERRORS if name == unit else _RECORDING
        wrong = [key for key in keys if getattr(given, key) != getattr(plain, key)]
        if wrong:
            right = f'"{before}gyro" and "{before}accel"' if name == unit else f'"{unit}"'
            raise ValueError(f'The fault {wrong[0]} of "{name}" has to be given for {right}.')


def _steps(value: float | tuple[tuple[float, float], ...], time_s: Array) -> Array:
    """A constant, or the steps (from time, value), at these times."""
    if isinstance(value, int | float):
        return np.full(time_s.size, float(value))
    times, values = np.array(value, dtype=np.float64).T
    return values[np.maximum(np.searchsorted(times, time_s, side="right") - 1, 0)]


def _believed(draws: Mapping[str, tuple[Parameter, ...]], calibrated: Calibrated) -> dict[str, tuple[Parameter, ...]]:
    """Constants with what a calibration found of them."""
    return {what: with_calibrated(constants, calibrated) for what, constants in draws.items()}


def _drive_streams(scene: _Scene, drive: Mechanisation, place: Start) -> dict[str, Stream]:
    if isinstance(drive, Imu):
        return {"imu": _inertial(scene, drive)}
    if drive.velocity_sensor is None:
        raise ValueError(f"The simulator knows Imu and DeadReckoning, found {type(drive).__name__}.")
    # both error blocks of dead reckoning tick with the drive, so both streams are read at its rate
    time_s = scene.ticks(drive.rate_hz)
    here = scene.motion.at(time_s)
    error = scene.error("attitude", drive.models[:3], drive.rate_hz, time_s, 3)
    # what is constant of a Heading is part of the drive's error model already
    plain = drive.compass and dataclasses.replace(drive.compass, bias_sd_rad=0.0, declination_sd_rad=0.0)
    truth = scene.truth("attitude", plain, error, time_s)
    angles = attitude(here, truth, drive.declination(place))
    return {
        "attitude": scene.stamp("attitude", time_s, *angles, scene.lateness("attitude", drive.compass)),
        "velocity": scene.record(
            "velocity", dataclasses.replace(drive.velocity_sensor, rate_hz=drive.rate_hz), drive.rate_hz
        ),
    }


def _inertial(scene: _Scene, drive: Imu, stream: str = "imu", before: str = "") -> Stream:
    """What an inertial unit reads; names of its parts begin with `before`."""
    time_s, *ideal = scene.motion.inertial(drive.rate_hz, increments=drive.increments, duration_s=scene.duration_s)
    parts = []
    for name, vector, models in zip(("gyro", "accel"), ideal, (drive.models[:3], drive.models[3:]), strict=True):
        error = scene.error(before + name, models, drive.rate_hz, time_s, 3)
        draws, moving = drive.draws(name), [m for key, m in drive.wandering().items() if key.startswith(f"{name}.")]
        if moving:
            draws |= {"scales": (_ZERO,) * 3}
        truth = scene.truth(before + name, None, error, time_s, _believed(draws, drive.calibrated))
        measured = truth.turned_and_scaled(vector)
        measured += error / drive.rate_hz if drive.increments else error
        M = np.diag(truth.drawn["scales"])
        M[tuple(zip(*CROSSED[name], strict=True))] = truth.drawn["axes"]
        if moving:
            M = np.repeat(M[None], time_s.size, axis=0)
            for axis, model in enumerate(moving):
                scale = draw_error(model, drive.period_s, time_s.size, scene.seed, f"{before}{name}.scale", axis)
                M[:, axis, axis] = scale
            measured[:] = np.linalg.solve(np.eye(3) - M, measured[..., None])[..., 0]
        elif M.any():  # true = reading - M reading - error
            measured[:] = np.linalg.solve(np.eye(3) - M, measured.T).T
        parts.append(quantise(measured, scene.fault(before + name).quantisation))
    columns = _INCREMENTS if drive.increments else _RATES
    return scene.stamp(stream, time_s, np.hstack(parts), columns)


_RATES = ("rate_x_rad_s", "rate_y_rad_s", "rate_z_rad_s", "force_x_m_s2", "force_y_m_s2", "force_z_m_s2")
_INCREMENTS = ("angle_x_rad", "angle_y_rad", "angle_z_rad", "velocity_x_m_s", "velocity_y_m_s", "velocity_z_m_s")


def _truth(here: Kinematics) -> Stream:
    place = np.stack([here.latitude, here.longitude, here.height], axis=-1)
    return Stream(here.time_s, np.hstack([place, here.velocity_n, here.attitude]), TRUTH_COLUMNS)


def _draw_start(here: Kinematics, known: StartErrors, seed: int, date: datetime.date) -> Start:
    position_sd = np.broadcast_to(np.asarray(known.position_sd_m, dtype=np.float64), (3,))
    angle_sd = np.radians([known.tilt_sd_deg, known.tilt_sd_deg, known.heading_sd_deg])
    sd = np.concatenate([position_sd, [known.velocity_sd_m_s] * 3, angle_sd])
    error = np.zeros(9) if known.exact else sd * generator(seed, "start", "error").normal(size=9)
    latitude, longitude, height = here.displaced(error[None, :3])
    turned = Rotation.from_rotvec(error[6:]) * Rotation.from_matrix(here.C_nb[0])
    heading, pitch, roll = turned.as_euler("ZYX", degrees=True)
    north, east, down = (here.velocity_n[0] + error[3:6]).tolist()
    return Start(
        latitude_deg=math.degrees(latitude[0]),
        longitude_deg=math.degrees(longitude[0]),
        height_m=float(height[0]),
        velocity_n=(north, east, down),
        roll_deg=float(roll),
        pitch_deg=float(pitch),
        heading_deg=float(heading),
        position_sd_m=(float(position_sd[0]), float(position_sd[1]), float(position_sd[2])),
        velocity_sd_m_s=known.velocity_sd_m_s,
        tilt_sd_deg=known.tilt_sd_deg,
        heading_sd_deg=known.heading_sd_deg,
        date=date,
    )


def tiny_missions() -> Iterator[tuple[Vehicle, Mission]]:
    """Two missions of a few seconds that between them use every drive and every kind of sensor, for compiling ahead of
    time.
    """
    sensors: dict[str, Sensor] = {}
    for kind in kinds_below(Sensor):
        for sensor in kind.examples():  # type: ignore[attr-defined]
            sensors[f"{kind.__name__.lower()}-{len(sensors)}"] = sensor
    # whose clock a verdict may ask for
    sensors["late-heading"] = Heading(rate_hz=4.0, error=White(sd=0.01), time_offset_sd_s=0.1)
    sensors["late-velocity"] = BodyVelocity(rate_hz=4.0, time_offset_sd_s=0.1)
    fix = next(name for name, sensor in sensors.items() if sensor.gives == "position")
    course = Heading(rate_hz=4.0, error=White(sd=0.01), deviation_sd_rad=(0.01, 0.01))
    reckoning = DeadReckoning(rate_hz=4.0, attitude=course, velocity=BodyVelocity(rate_hz=4.0, scale_sd=0.01))
    yield _tiny(Vehicle(imu=Imu(rate_hz=20.0), sensors=sensors, name="tiny-inertial"))
    late = dataclasses.replace(sensors[fix], time_offset_sd_s=0.1)
    yield _tiny(Vehicle(reckoning, {fix: late}, name="tiny-reckoning"))


def tiny_mission(vehicle: Vehicle) -> tuple[Vehicle, Mission]:
    """A mission of a few seconds for the drive and the sensors of a vehicle, each of which is heard in it."""
    heard = {
        name: dataclasses.replace(sensor, rate_hz=max(sensor.rate_hz, 1.0), error=White(sd=1.0))
        for name, sensor in vehicle.sensors.items()
    }
    return _tiny(dataclasses.replace(vehicle, sensors=heard))


def _tiny(vehicle: Vehicle) -> tuple[Vehicle, Mission]:
    """With a mission: what the simulator cannot read reads zeros."""
    silent = [
        name
        for name, sensor in vehicle.sensors.items()
        if type(sensor).simulated is Sensor.simulated and not sensor.from_drive
    ]
    heard = vehicle.without(*silent)
    motion = Motion((Wait(3.0), ChangeSpeed(1.0, 2.0)), latitude_deg=30.0)
    late = Faults(hdop=1.0, time_offset_s=0.03)  # readings between the samples of the drive
    mission = simulate(heard, motion, seed=1, faults=dict.fromkeys(heard.sensors, late), name=vehicle.name)
    times = np.arange(1.0, 4.0)
    for name in silent:
        values = np.zeros((times.size, vehicle.sensors[name].reads))
        mission.streams[name] = Stream(times, values, tuple(f"column_{k}" for k in range(values.shape[1])))
    return vehicle, mission
