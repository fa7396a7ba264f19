"""Constants by the likelihood of whole missions: Gauss-Newton, each step a run of the filter."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np

from navfilter.calibration.parts import Constant, constants_of, described
from navfilter.foundation.arrays import Array, Mask
from navfilter.foundation.chi_square import chi_square_limit
from navfilter.models.mission import Mission
from navfilter.models.vehicle import Vehicle
from navfilter.playback.replay import at_the_end

#: The constants have settled when a step moves none of them by more than this share of its standard deviation.
SETTLED = 0.1
#: A later step lets them wander by so many of the standard deviations of the step before: around where it is linear.
AROUND = 3.0
#: Steps at most.
ROUNDS = 8
#: A scatter between missions is chance up to this share of what chance does.
BY_CHANCE = 0.95


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
        By their likelihood.
    rounds : int
        Steps that it took.
    settled : bool
        Whether the last step moved none of them by more than `SETTLED`.
    between : ndarray, shape (k,)
        Standard deviations by leaving out a mission at a time (jackknife); zero of one mission, and of a scatter that
        is no more than chance.
    unsettled : ndarray, shape (k,)
        What the second half of the steps moved them by, in quadrature; zero where they have settled.
    """

    constants: tuple[Constant, ...]
    value: Array
    covariance: Array
    rounds: int
    settled: bool
    between: Array
    unsettled: Array

    @property
    def sd(self) -> Array:
        """Standard deviations, shape (k,): of the likelihood, and of what has not settled."""
        return np.sqrt(np.diag(self.covariance) + self.unsettled**2)

    def told(self, untold: float) -> Mask:
        """Which of them the missions have told: less than this share of the prior's sd is left."""
        return self.sd <= untold * np.array([one.sd for one in self.constants])

    def shown(self, untold: float) -> Mask:
        """The same, and of which they say something, although it has not settled."""
        return np.sqrt(np.diag(self.covariance)) <= untold * np.array([one.sd for one in self.constants])


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
    sec. 7.7), with a smaller ``s``, so that the filter stays where it is linear. A step back goes half the way. Where
    they have not settled, the variances are larger by the squares of what the second half of the steps moved: constants
    that ran away by fifteen sds of their prior were believed to a third of one.
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
    move, moves = np.zeros(len(value)), []
    while number < rounds and not settled:
        number += 1
        J, i = J0.copy(), J0 @ prior
        at, each_said = described(vehicle, _moved(constants, value, s)), []
        for mission in missions:
            if report is not None:
                report(done)
            more = said(at, mission, constants, value, s)
            each_said.append((weight * more[0], weight * more[1]))
            J, i, done = J + each_said[-1][0], i + each_said[-1][1], done + 1
        covariance = _inverse(J)
        before, move = move, covariance @ i - value
        sd = np.sqrt(np.diag(covariance))
        settled = bool(np.all(np.abs(move) < SETTLED * sd))
        if move @ J @ before < 0.0 and not settled:
            move = 0.5 * move  # it goes to and fro about where it will be
        value = value + move
        moves.append(np.abs(move))
        s = np.minimum(prior_sd, AROUND * sd)
    # where a step still leads elsewhere, what it was linear around does not hold for less than that
    last = moves[-max(2, len(moves) // 2) :]
    unsettled = np.zeros(len(value)) if settled else np.sqrt(np.sum(np.square(last), axis=0))
    between = _between(J, i, each_said, np.sqrt(np.diag(covariance)))
    return Estimate(constants, value, covariance, number, settled, between, unsettled)


def _between(J: Array, i: Array, each_said: Sequence[tuple[Array, Array]], sd: Array) -> Array:
    """How the constants scatter between the missions that told them, by what is found without each in turn; 0 where it
    is no more than chance makes of these standard deviations.
    """
    n = len(each_said)
    if n < 2:
        return np.zeros(len(i))
    without = np.array([_inverse(J - of) @ (i - times_value) for of, times_value in each_said])
    variance = (n - 1) / n * np.sum((without - without.mean(axis=0)) ** 2, axis=0)
    most = chi_square_limit(BY_CHANCE, n - 1) / (n - 1)
    return np.where(variance > most * sd**2, np.sqrt(variance), 0.0)


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
