"""How a simulated sensor really errs: noise drawn from error models, and faults that its description does not mention.

Every random number comes from a generator that belongs to one stream and one purpose, derived from the mission's seed
and their names. Adding a sensor, or a fault to one sensor, changes nothing in the noise of the others; a longer mission
begins with the noise of the shorter one.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy  # its parts are imported when they are first used: that takes a second
from scipy.linalg import schur

from navfilter.foundation.arrays import Array
from navfilter.models.error_models import ErrorModel, per_axis

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
