"""Integrity: how far the truth may be from the state although nothing has been said, and whether it is to be trusted.

The protection radius is that of fault-free noise and of every single fault that the gates would have let pass (solution
separation in its cheap form: Blanch et al., 2015; the smallest fault that is detected is Baarda's, 1968; Groves, 2013,
ch. 17). A sensor whose readings are used may be off by a constant of up to the square root of its gate's limit times
the sd of its readings, slow error and all; one whose readings are refused by the residual itself, for it may be the
one that is right.
What such a constant does to the position:

- of fixes: it is the error; where the state has been set to them, it may have been right before;
- of a velocity: it has been integrated since the last fix; so have the residuals of readings that were refused, for
  nobody knows yet who was right;
- of a heading: it turns the way made since the last fix.

A fault of the drive that nobody has seen yet turns the heading, too: no further from the compass than its gate lets
pass, and the compass itself is off by its slow error. The covariance knows nothing of that, for it trusts the drive.

Faults do not come together: the largest of these counts, beside the noise of the state itself.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navfilter.faults import settings
from navfilter.models.health import LOST_HEADING, LOST_VELOCITY, MARGIN, Trust

Array = NDArray[np.float64]

#: The distance in a plane, and the size of an angle, that noise of unit sd exceeds in that share of the time.
IN_PLANE, IN_LINE = math.sqrt(-2.0 * math.log(settings.RISK)), 3.2905


def bounds(
    P: Array,
    age_s: Any,
    moved_m: Any,
    off: Mapping[str, Any],
    held: bool = True,
    slow: Any = 0.0,
    beside_m: Any = 0.0,
    compared: bool = True,
    unnoticed_m: Any = 0.0,
    unnoticed_rad: Any = 0.0,
) -> tuple[Any, Any]:
    """Protection radius [m] and bound of the heading [rad] at one time, or at many.

    Parameters
    ----------
    P : ndarray, shape (..., 9, 9)
        Covariance of position, velocity and attitude in n.
    age_s, moved_m : float or ndarray, shape (...)
        Time since the last fix that was used, or since the start [s], and distance from there [m].
    off : dict of str to float or ndarray
        What the sensors of "position", "velocity" and "heading" may be off by [m, m/s, rad].
    held : bool
        Whether anything holds the velocity and the heading of the drive against others. Dead reckoning without an
        inertial unit has nothing: between fixes its radius is infinite.
    slow : float or ndarray
        Variance of the slow error of what tells the heading [rad^2].
    beside_m : float or ndarray, shape (...)
        What the refused readings of a velocity have come to since the last fix [m].
    compared : bool
        Whether anything holds the heading of the drive against another. A compass that drives and is the only one may
        be off by anything.
    unnoticed_m, unnoticed_rad : float or ndarray, shape (...)
        What slow faults may have done to position and heading, see `navfilter.kernels.fault_bank` [m, rad].

    Examples
    --------
    >>> P = np.diag([4.0, 4.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1e-4])
    >>> radius_m, heading_rad = bounds(P, 600.0, 500.0, {"velocity": 0.05, "heading": 0.04})
    >>> round(float(radius_m), 1)
    37.4
    """
    away = np.asarray(age_s) > settings.RECENT_S
    heading = off.get("heading", 0.0)
    by_heading = 2.0 * np.sin(0.5 * np.minimum(heading, math.pi)) * moved_m
    by_velocity = np.maximum(np.multiply(age_s, off.get("velocity", 0.0)), beside_m)
    by_motion = np.maximum(by_heading, by_velocity) if held else math.inf
    fault = np.maximum(np.maximum(off.get("position", 0.0), np.where(away, by_motion, 0.0)), unnoticed_m)
    heading = np.maximum(heading, unnoticed_rad)
    half = 0.5 * (P[..., 0, 0] + P[..., 1, 1])
    longest = half + np.hypot(0.5 * (P[..., 0, 0] - P[..., 1, 1]), P[..., 0, 1])
    heading_sd = np.sqrt(np.maximum(P[..., 8, 8], slow))
    most = np.minimum(IN_LINE * heading_sd + heading, math.pi) if compared else np.full(np.shape(heading_sd), math.pi)
    return IN_PLANE * np.sqrt(longest) + fault, most


def whole_offset(sees: str, residual: Array, slow: float) -> Array:
    """What the state may be off by where readings are refused: the size of their residuals (..., axes), of fixes that
    of the horizontal part, and beside it what the slow error of the sensor, of this variance, makes of them.
    """
    known = np.nan_to_num(np.abs(residual))
    several = sees == "position" and known.shape[-1] > 1
    size = np.hypot(known[..., 0], known[..., 1]) if several else known.max(axis=-1)
    return np.asarray(size + (IN_PLANE if several else IN_LINE) * math.sqrt(slow))


def trust(
    P: Array, speed: float, turn: float, limits: tuple[float | None, float | None], doubts: Iterable[str]
) -> Trust:
    """Whether a state is to be trusted, and why not.

    Parameters
    ----------
    P : ndarray, shape (9, 9)
    speed, turn : float
        Of the vehicle [m/s], [rad/s].
    limits : (2,) float or None
        What the vehicle can do at most.
    doubts : iterable of str
        What does not help at present, in words.
    """
    variances = P.diagonal().tolist()
    if not all(variance >= 0.0 for variance in variances):  # NaN is none either
        return Trust("lost", ("the covariance is that of no state any more: begin again from a start or a snapshot",))
    velocity_sd, heading_sd = math.sqrt(max(variances[3:6])), math.sqrt(variances[8])
    lost = []
    for what, value, most, unit in zip(("speed", "turn"), (speed, turn), limits, ("m/s", "rad/s"), strict=True):
        if most is not None and value > most * MARGIN:
            lost.append(f"a {what} of {value:.3g} {unit}, the vehicle's greatest is {most:g} {unit}")
    if not velocity_sd <= LOST_VELOCITY:
        lost.append(f"the velocity is only known to {velocity_sd:.2g} m/s")
    if not heading_sd <= LOST_HEADING:
        lost.append(f"the heading is only known to {math.degrees(heading_sd):.0f} deg")
    reasons = (*lost, *doubts)
    return Trust("lost" if lost else "degraded" if reasons else "good", reasons)
