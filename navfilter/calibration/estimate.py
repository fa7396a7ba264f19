"""Constants by the likelihood of whole missions: Gauss-Newton, each step a run of the filter."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from navfilter.calibration.parts import Constant, constants_of, described
from navfilter.mission import Mission
from navfilter.playback import at_the_end
from navfilter.vehicle import Vehicle

__all__ = ["Estimate", "estimate", "said"]

Array = NDArray[np.float64]
#: The constants have settled when a step moves none of them by more than this share of its standard deviation.
SETTLED = 0.1
#: A later step lets them wander by so many of the standard deviations of the step before: around where it is linear.
AROUND = 3.0
#: Steps at most.
ROUNDS = 8


@dataclass(frozen=True)
class Estimate:
    """Constants of a vehicle after missions.

    Attributes
    ----------
    constants : tuple of Constant
        As described before: the prior.
    value, sd : ndarray, shape (k,)
        As found.
    covariance : ndarray, shape (k, k)
    rounds : int
        Steps that it took.
    settled : bool
        Whether the last step moved none of them by more than `SETTLED`.
    """

    constants: tuple[Constant, ...]
    value: Array
    covariance: Array
    rounds: int
    settled: bool

    @property
    def sd(self) -> Array:
        """Standard deviations, shape (k,)."""
        return np.sqrt(np.diag(self.covariance))

    def told(self, untold: float) -> NDArray[np.bool_]:
        """Which of them the missions have told: less than this share of the prior's sd is left."""
        return self.sd <= untold * np.array([one.sd for one in self.constants])


def estimate(
    vehicle: Vehicle,
    missions: Sequence[Mission],
    guess: Array | None = None,
    spread: Array | None = None,
    rounds: int = ROUNDS,
    weight: float = 1.0,
    each: Collection[str] = (),
    report: Callable[[int], None] | None = None,
) -> Estimate:
    """The constants that a vehicle is unsure of, from one or several missions.

    Parameters
    ----------
    vehicle : Vehicle
        Its values and standard deviations of them are the prior.
    missions : sequence of Mission
    guess, spread : ndarray, shape (k,), optional
        Where the first step is linearised, and how far the constants may wander from there; default: the prior.
    rounds : int
        Steps at most.
    weight : float
        Of what the missions say, where their readings scatter more than described.
    each : collection of str
        Kinds, or names, of constants that are others in each mission: states with the prior of the vehicle in each,
        and not estimated together.
    report : callable, optional
        Told before each run how many runs have been done.

    Returns
    -------
    Estimate

    Raises
    ------
    ValueError
        When the vehicle is sure of all its constants, and as `navfilter.replay`.

    Notes
    -----
    A constant state at the end of a forward run is what the smoother gives for the whole run. The run of a mission with
    the constants at ``c``, each with the sd ``s`` of this step, ends with the posterior ``N(x, P)``; what the mission
    itself says is ``J = inv(P) - inv(diag(s^2))`` and ``i = inv(P) x - inv(diag(s^2)) c``. Information of several
    missions adds to that of the prior. The next step is taken around what this one found (Gauss-Newton; Kay, 1993,
    sec. 7.7), with a smaller ``s``, so that the filter stays where it is linear.
    """
    constants = constants_of(vehicle, each)
    if not constants:
        raise ValueError(
            "this vehicle is sure of all its constants: give those in doubt a standard deviation (time_offset_sd_s, "
            "lever_arm_sd_m, scale_sd, misalignment_sd_deg, ..), or name the kinds to open."
        )
    prior, prior_sd = (np.array([getattr(one, key) for one in constants]) for key in ("value", "sd"))
    value = prior if guess is None else guess
    s = prior_sd if spread is None else np.minimum(prior_sd, spread)
    J0 = np.diag(prior_sd**-2)
    done, number, settled, covariance = 0, 0, False, np.diag(prior_sd**2)
    while number < rounds and not settled:
        number += 1
        J, i = J0.copy(), J0 @ prior
        at = described(vehicle, _moved(constants, value, s))
        for mission in missions:
            if report is not None:
                report(done)
            more = said(at, mission, constants, value, s)
            J, i, done = J + weight * more[0], i + weight * more[1], done + 1
        before, covariance = value, _inverse(J)
        value, sd = covariance @ i, np.sqrt(np.diag(covariance))
        settled = bool(np.all(np.abs(value - before) < SETTLED * sd))
        s = np.minimum(prior_sd, AROUND * sd)
    return Estimate(constants, value, covariance, number, settled)


def _moved(constants: Sequence[Constant], value: Array, sd: Array) -> list[Constant]:
    return [one._replace(value=float(v), sd=float(s)) for one, v, s in zip(constants, value, sd, strict=True)]


def said(
    vehicle: Vehicle, mission: Mission, constants: Sequence[Constant], value: Array, s: Array
) -> tuple[Array, Array]:
    """Information of one mission on the constants, and that times their value.

    Parameters
    ----------
    vehicle : Vehicle
        That begins with these constants at `value`, with the standard deviations `s`.
    mission : Mission
    constants : sequence of Constant
        All of the vehicle.
    value, s : ndarray, shape (k,)

    Returns
    -------
    information : ndarray, shape (k, k)
    vector : ndarray, shape (k,)
    """
    nav = at_the_end(vehicle, mission)
    layout = nav.filter.layout
    at = np.array([layout.names.index(one.name) for one in constants])
    P = nav.filter.P[np.ix_(9 + at, 9 + at)]
    x = value + nav.filter.x[at] - layout.start_states()[at]
    inverse = _inverse(P)
    J = inverse - np.diag(s**-2)
    i = inverse @ x - value / s**2
    values, vectors = np.linalg.eigh(J * np.outer(s, s))
    if values.min() < 0.0:
        # rounding, or a state that was given up on the way: nothing can be told less than nothing
        positive = (vectors * np.maximum(values, 0.0)) @ vectors.T / np.outer(s, s)
        return positive, i + (positive - J) @ value
    return J, i


def _inverse(P: Array) -> Array:
    """Inverse of a covariance or an information, scaled to a unit diagonal first."""
    d = np.sqrt(np.diag(P))
    inverse = np.linalg.inv(P / np.outer(d, d)) / np.outer(d, d)
    return 0.5 * (inverse + inverse.T)
