"""What every kind of sensor says of itself: the rest of the program asks it and keeps no list of kinds."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import MISSING, dataclass, fields
from typing import Any, ClassVar

import numpy as np

from navfilter.foundation.arrays import Array, ArrayLike, Mask
from navfilter.foundation.frozen import FrozenDescription
from navfilter.kernels import open_loop_residual
from navfilter.models.error_models import ErrorModel, Errors, White, check_numbers, per_axis
from navfilter.models.learned_arma import resolve_prior
from navfilter.models.navigation_drift import Drift, DriftSource
from navfilter.models.parameters import Calibrated, Parameter, check_calibrated, constant_parameters, with_calibrated
from navfilter.models.sensors.observable import Observable
from navfilter.models.sensors.traits import Columns, Doubt, Example, Plausible, kind_name
from navfilter.models.start import Start
from navfilter.models.truth import Kinematics, SimulatedReading, Truth

Vector = tuple[float, float, float]
#: A stamp that is early by more standard deviations of the time offset is not waited for.
EARLY_SDS = 2.5
#: What is seen of the motion after a reading, at least [s].
SEEN_S = 0.2
#: Keys that parameters come on top of, and how the names of these begin.
ON_TOP = {
    "time_offset_s": "time_offset",
    "lever_arm_b_m": "lever_arm_",
    "mounting_rad": "misalignment_",
    "transceiver_mounting_rad": "misalignment_",
    "hard_iron": "hard_iron_",
    "soft_iron": "soft_iron_",
    "beacons": "beacon_",
}
#: A number beyond this is no measurement in any unit: a pressure at the greatest depth is 1e8 Pa.
LARGEST = 1e12


@dataclass(frozen=True, kw_only=True)
class Sensor(FrozenDescription):
    """What all correcting sensors share.

    Parameters
    ----------
    rate_hz : float
        Nominal rate [Hz]; coloured errors tick at it.
    error : ErrorModel or tuple of ErrorModel
        How the sensor errs: one model for all axes, or one per axis.
    gate_probability : float
        A reading is rejected when its normalised innovation squared (NIS) exceeds this quantile of chi-square.
    gate_timeout_s : float
        After rejecting every reading for so long the gate doubles (and again), so that a good sensor is never locked
        out.
    time_offset_s : float
        How late its stamps are [s]: a reading stamped t was taken at ``t - time_offset_s``.
    time_offset_sd_s : float
        Standard deviation of what is left of that offset [s], a constant state; 0 leaves the state out. Unknown clocks:
        0.3.
    lever_arm_sd_m : (3,) float
        Standard deviation of each component of `lever_arm_b_m` [m], three constant states; all zero: no such states.
    calibrated : tuple of (str, float, float)
        What a calibration found of the constant states of its kind: name, value and remaining standard deviation.

    Attributes
    ----------
    prior : ErrorModel
        Of a `LearnedArma` that brings none.
    unit, axes, axis_names
        Of the error: unit, number and names of its axes.
    axis_units : tuple of str
        Unit of each axis, where they are not all that of `unit`; see `units`.
    reads : int
        Number of elements of a reading that must be there.
    kernel : callable
        Residual and Jacobian, with the arguments of `navfilter.kernels.measurement`.
    from_drive : bool
        Made from the drive's own samples: there is no stream, and there are no readings.
    single_gates : bool
        A component that contradicts the others is left out alone, as long as more than half of them remain.
    deviation : int or None
        Which of its parameters begin a deviation with the heading, that no reading tells from it: see
        `consistency.turn_deviation`.
    hidden : bool
        Parameters whose slopes are held may be hidden by the state's error, see `delayed_state.withhold_hidden`.
    single_s : float
        For so long on end [s]: where the others do not tell what it does, the reading is refused whole after that.
    tracks : int
        The axes are so many equal sets: a reading's own sd may be given for one of them.
    bend : callable, optional
        What its linear equation leaves out where it stands near what it measures, with the arguments of
        ``consistency.range_second_order``.
    late_s : float
        Its readings may come so late [s]: a navigator keeps as much of the past.
    confirms_state : bool
        Readings that fit say that the state is right, whatever the others read.
    open_loop : int
        How the feedback is taken off again for learning, see `navfilter.kernels.open_loop_residual`; NOTHING: its error
        cannot be learnt under way. The direction in which an axis sees the state must not turn much within a window of
        learning, or the drift is no chain.
    gives : str
        What a start can take from one reading alone: "position" (latitude, longitude, height), "heading", "attitude",
        "depth", "velocity", or nothing. Those of a heading and an attitude have a method `headings`.
    flows_m_s : float
        By so much that velocity may change without the vehicle, because it is one through moving water [m/s].
    observes : Observable
        What of the state it observes. Fault rules and figures ask for this; a kind of its own states NONE.
    jumps : int, optional
        The one component that may come to be off by a constant; None: any may.
    contents, beside : tuple
        What a stream of a file may consist of: alternatives, each of one or more groups of columns; groups that may
        stand beside them.
    plausible : Plausible, optional
        What such a sensor usually errs by.
    template : Example, optional
        How it stands in a vehicle.toml to start from.
    """

    rate_hz: float = 1.0
    error: Errors = White(sd=1.0)
    gate_probability: float = 0.9999
    gate_timeout_s: float = 20.0
    time_offset_s: float = 0.0
    time_offset_sd_s: float = 0.0
    lever_arm_sd_m: Vector = (0.0, 0.0, 0.0)
    calibrated: Calibrated = ()

    prior: ClassVar[ErrorModel] = White(sd=1.0)
    unit: ClassVar[str] = "m"
    axes: ClassVar[int] = 1
    axis_units: ClassVar[tuple[str, ...]] = ()
    reads: ClassVar[int] = 1
    axis_names: ClassVar[tuple[str, ...]] = ("",)
    kernel: ClassVar[Callable[..., None]]
    from_drive: ClassVar[bool] = False
    single_gates: ClassVar[bool] = False
    hidden: ClassVar[bool] = False
    deviation: ClassVar[int | None] = None
    single_s: ClassVar[float] = math.inf
    tracks: ClassVar[int] = 1
    bend: ClassVar[Callable[..., None] | None] = None
    late_s: ClassVar[float] = 0.0
    confirms_state: ClassVar[bool] = True
    open_loop: ClassVar[int] = open_loop_residual.NOTHING
    gives: ClassVar[str] = ""
    flows_m_s: ClassVar[float] = 0.0
    observes: ClassVar[Observable] = Observable.NONE
    jumps: ClassVar[int | None] = None
    contents: ClassVar[tuple[tuple[Columns, ...], ...]] = ()
    beside: ClassVar[tuple[Columns, ...]] = ()
    plausible: ClassVar[Plausible | None] = None
    template: ClassVar[Example | None] = None

    @property
    def ground(self) -> int:
        """How many of its first components are of the velocity in body axes: three axes, or the beams of a DVL."""
        return self.axes // self.tracks if self.observes.in_body_axes else 0

    def __post_init__(self) -> None:
        super().__post_init__()
        name = type(self).__name__
        check_numbers(self, "rate_hz", zero_ok=False)
        if not 0.5 <= self.gate_probability < 1.0:
            raise ValueError(
                f"{name}.gate_probability must lie in [0.5, 1), found {self.gate_probability!r}. Typical: 0.999."
            )
        if not self.gate_timeout_s > 0:
            raise ValueError(f"{name}.gate_timeout_s must be > 0, found {self.gate_timeout_s!r}.")
        self._check_place_and_clock(name)
        self._check_calibrated(name)
        _ = self.models

    def _check_place_and_clock(self, name: str) -> None:
        """Refuse what no kind can use."""
        if not math.isfinite(self.time_offset_s):
            raise ValueError(f"{name}.time_offset_s must be a finite number, found {self.time_offset_s!r}.")
        check_numbers(self, "time_offset_sd_s")
        if self.from_drive and (self.time_offset_s or self.time_offset_sd_s):
            raise ValueError(
                f"{name} has no clock of its own: it is made from the drive's samples. Leave the time_offset out."
            )
        if self.has_lever_arm:
            checked_vector(f"{name}.lever_arm_b_m", self.lever_arm_b_m)  # type: ignore[attr-defined]
        checked_vector(f"{name}.lever_arm_sd_m", self.lever_arm_sd_m)
        if min(self.lever_arm_sd_m) < 0.0:
            raise ValueError(f"{name}.lever_arm_sd_m must be three numbers >= 0, found {self.lever_arm_sd_m!r}.")
        if any(self.lever_arm_sd_m) and not self.has_lever_arm:
            raise ValueError(f"{name} has no lever arm that could be uncertain: leave lever_arm_sd_m out.")

    def _check_calibrated(self, owner: str) -> None:
        """Refuse constants that this sensor does not have."""
        known = constant_parameters(self.parameters(), self.wandering()) if self.calibrated else ()
        check_calibrated(owner, self.calibrated, [p.name for p in known])

    @property
    def models(self) -> tuple[ErrorModel, ...]:
        """The error model of each axis; a `LearnedArma` that brings no prior gets that of the sensor's kind."""
        return resolve_prior(per_axis(self.error, self.axes, f"{type(self).__name__}.error"), self.prior)

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of the error of each axis."""
        return self.axis_units or (self.unit,) * self.axes

    @property
    def has_lever_arm(self) -> bool:
        """Whether its kind has a field `lever_arm_b_m`."""
        return hasattr(self, "lever_arm_b_m")

    def parameters(self) -> tuple[Parameter, ...]:
        """States of its kind beside the error model; constant, but for those of `wandering`."""
        return ()

    def place_and_clock(self) -> tuple[Parameter, ...]:
        """Constant states that any kind may have: lever arm, then time offset."""
        arm = tuple(Parameter(f"lever_arm_{a}", sd, "m") for a, sd in zip("xyz", self.lever_arm_sd_m, strict=True))
        clock = (Parameter("time_offset", self.time_offset_sd_s, "s"),)
        return (arm if any(self.lever_arm_sd_m) else ()) + (clock if self.time_offset_sd_s else ())

    def nominal(self, parameter: str) -> Any:
        """The key that a parameter comes on top of, by its value; None where there is none."""
        keys = (key for key, made in ON_TOP.items() if parameter.startswith(made) and hasattr(self, key))
        return next((getattr(self, key) for key in keys), None)

    @property
    def lead_s(self) -> float:
        """How long its readings wait, so that even one whose stamp is early has been taken by then [s]."""
        return EARLY_SDS * self.time_offset_sd_s + SEEN_S if self.time_offset_sd_s else 0.0

    def all_parameters(self) -> tuple[Parameter, ...]:
        """All states beside the error model, in their order."""
        return with_calibrated(self.parameters(), self.calibrated) + self.place_and_clock()

    def mean_variance(self, axis: int, count: int) -> float:
        """Of the mean of so many readings of an axis that follow each other: white noise averages out, what is slow
        does not.
        """
        block = self.models[axis].block(1.0 / self.rate_hz)
        return block.r / count + block.state_variance

    @property
    def still_m_s(self) -> float:
        """A velocity that reads less stands still, and shows no error by which one under way is told [m/s]; 0: none."""
        return 0.0

    def held(self) -> tuple[int, int]:
        """From which of its parameters to which the slopes are velocities, see `consistency.limit_velocity_slopes`."""
        return 0, 0

    def wandering(self) -> dict[str, ErrorModel]:
        """Those of the parameters that are not constant: how they wander, by name (a model of one state)."""
        return {}

    def at(self, start: Start) -> "Sensor":
        """As it is at this place: itself, but for what is known less well there."""
        return self

    def constants(self, start: Start) -> Array:
        """What the kernel needs to know beside the state, shape depends on the sensor."""
        return np.zeros(1)

    def over_ground(self, values: Array) -> Array:
        """Values by axis (n, axes) as velocities over ground, shape (n, 3); of a sensor that has one."""
        return values[:, : self.ground]

    def read(self, value: Array) -> Array | None:
        """Turn what arrives into what the kernel takes; None when it is not a reading (lost lock, out of range)."""
        seen = np.abs(value) <= LARGEST
        if seen.all():
            return value
        return np.where(seen, value, np.nan) if seen.any() else None

    @property
    def plain(self) -> tuple[float, int]:
        """A reading of `reads` values, none larger than the first number and not all of them 0, is taken as it is, with
        NaN behind it up to as many values as the second: `read` need not be asked. Always where that is (0, 0).
        """
        return (LARGEST, self.reads) if type(self).read is Sensor.read else (0.0, 0)

    def read_all(self, values: Array | Sequence[Array]) -> tuple[Array, Mask]:
        """`read` of many readings: what it makes of each, NaN beyond, and which of them are readings.

        Parameters
        ----------
        values : ndarray, shape (n, w), or sequence of ndarray
            None of those of fewer than `reads` values is a reading.

        Returns
        -------
        z : ndarray, shape (n, most that one of them gives)
        good : ndarray of bool, shape (n,)
        """
        raw = [np.array(value, dtype=np.float64) for value in values]
        found = [self.read(value) if len(value) >= self.reads else None for value in raw]
        good = np.array([z is not None for z in found], dtype=bool)
        z = np.full((len(found), max((len(z) for z in found if z is not None), default=0)), np.nan)
        for row, one in zip(z, found, strict=True):
            if one is not None:
                row[: len(one)] = one
        return z, good

    # ---------------------------------------------------------------- what the filter asks
    def felt(self, mean: Array, scatter: Array, velocity: Array, P: Array) -> Array | None:
        """The reading that the drive's own samples of one period make, for kinds that are `from_drive`; None for none.

        Parameters
        ----------
        mean, scatter : ndarray, shape (6,)
            Mean and standard deviation of rates [rad/s] and forces [m/s^2].
        velocity, P : ndarray, shape (3,) and (3, 3)
            North, east, down, as the filter believes it at the end of the period, and its covariance.
        """
        return None

    @property
    def needs_rate(self) -> bool:
        """Whether the kernel needs the angular rate of the body."""
        return False

    def lever_arm_covariance(self, rate_variance: Array) -> Array:
        """What white noise of the gyros adds to a reading, shape (axes, axes).

        Parameters
        ----------
        rate_variance : ndarray, shape (3,)
            Of the three gyros, as rates [rad^2/s^2].
        """
        return np.zeros((self.axes, self.axes))

    # ---------------------------------------------------------------- what learning asks
    def instrument_axes(self) -> Array:
        """Rotation from the body's axes to the instrument's, shape (3, 3).

        Of a velocity along other directions than three axes: those directions in the body, shape (axes, 3).
        """
        return np.eye(3)

    def drift(self, drive: DriftSource, axis: int, walk: float) -> Drift:
        """How the slow navigation error looks in the open-loop residual of one axis; default: as a horizontal position.

        Parameters
        ----------
        drive : DriftSource
            Whose errors make it.
        axis : int
        walk : float
            Root PSD of the sensor's own known random walk, which stays beside whatever is learnt [unit/s/sqrt(Hz)].
        """
        return drive.position_drift(walk, 1.0 / self.rate_hz)

    # ---------------------------------------------------------------- what files and checks ask
    @property
    def words(self) -> str:
        """What it measures, in words; default: the name of the class."""
        return kind_name(type(self)).replace("-", " ")

    def stream_columns(self) -> tuple[str, ...]:
        """Names of the columns of its stream, those that must be there."""
        if self.contents:
            return tuple(name for columns in self.contents[0] for name in columns.names)
        return tuple(f"column_{k}" for k in range(self.reads))

    def doubts(self) -> Iterator[Doubt]:
        """Fields whose values were probably not meant so, beside error and rate."""
        yield from ()

    # ---------------------------------------------------------------- what the simulator and the warm-up ask
    def draws(self) -> dict[str, tuple[Parameter, ...]]:
        """Calibration errors that are drawn for a simulated mission: by name, the constants that are the components.

        Default: each of the parameters that is constant. What is `calibrated` is drawn about its value.
        """
        return {p.name: (p,) for p in constant_parameters(self.parameters(), self.wandering())}

    def simulated(self, here: Kinematics, truth: Truth) -> SimulatedReading:
        """What it reads along a motion: the truth side of the measurement equation, written from the definition, not
        from the kernel.

        Parameters
        ----------
        here : Kinematics
            Place, motion and attitude at the n ticks of the sensor.
        truth : Truth
            How the sensor really is: errors and calibration errors as drawn.

        Returns
        -------
        values : ndarray, shape (n, k)
        columns : tuple of str
            Their names.

        Raises
        ------
        ValueError
            Where the kind cannot be simulated.
        """
        raise ValueError(
            f"a {type(self).__name__} has no method simulated(): the simulator cannot read it. Give it one, or leave "
            "it out."
        )

    @classmethod
    def examples(cls) -> "tuple[Sensor, ...]":
        """Sensors that use all that is compiled or loaded for this kind; none where its defaults do not make one."""
        needed = any(f.init and f.default is MISSING and f.default_factory is MISSING for f in fields(cls))
        try:
            return () if needed or not hasattr(cls, "kernel") else (cls(),)
        except ValueError:
            return ()  # a default that stands for "must be given"


def _numbers(value: ArrayLike | None) -> Array:
    """As an array; an empty one for what is no numbers."""
    try:
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        return np.empty((0, 0))


def checked_vector(owner: str, value: ArrayLike, size: int = 3) -> tuple[float, ...]:
    """The value as a tuple of `size` finite floats; the error names its `owner`."""
    v = _numbers(value).ravel()
    if v.shape != (size,) or not np.isfinite(v).all():
        raise ValueError(f"{owner} must be {size} finite numbers, found {value!r}.")
    return tuple(float(c) for c in v)


def checked_sds(owner: str, value: float | Vector) -> tuple[float, ...]:
    """One standard deviation for all axes, or three, as a tuple of floats; the error names its `owner`."""
    v = np.atleast_1d(_numbers(value))
    if v.shape not in ((1,), (3,)) or not np.all((v >= 0.0) & np.isfinite(v)):
        raise ValueError(f"{owner} must be a finite number >= 0, or three of them (x, y, z), found {value!r}.")
    return tuple(v.tolist())
