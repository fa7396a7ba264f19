"""How much the learner computes, in one place: passes, steps and tolerances of the maximisation, and whose turn it
is.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class OptimiserSettings:
    """Numerical effort of learning; none of it says what is believed of a sensor.

    Attributes
    ----------
    first_passes : int
        Scoring passes of an order that was never fitted, while the window fills.
    late_passes : int
        The same later, when its turn comes.
    below_passes : int
        Passes of a lower order that only serves as a start.
    smooth_passes : int
        Passes of a fit with a slow part of second order.
    race_passes : int
        Passes of each of several starts before the leader goes on alone.
    zero_radius : float
        Largest radius of a zero: one on the circle would never forget its start.
    converged : float
        What is left to gain when an estimate counts as converged, in units of log-likelihood: a tenth of what the
        sampling error of one parameter costs.
    small_gain : float
        After a step that gains less, derivatives are not taken again: readings alone scatter an estimate by half a unit
        of log-likelihood for each parameter.
    hopeless : float
        An order that should stay so far behind the best, as a logarithm, is not fitted, or not improved: twenty to one,
        and it would not count.
    optimism : float
        What an order may gain, of what its slope says: the curvature beside it is that of other places.
    longest_step : float
        Largest change of ln sd in one step.
    differences : tuple of float
        Difference steps, the first that stays stable is taken: poles that crowd near the circle leave it at a very
        small one.
    slow_difference : float
        The same for ln sd and ln tau of the slow part.
    dampings : tuple of float
        Levenberg damping of a scoring step, relative to the information, until one gains.
    """

    first_passes: int = 10
    late_passes: int = 3
    below_passes: int = 8
    smooth_passes: int = 5
    race_passes: int = 2
    zero_radius: float = 0.9995
    converged: float = 0.05
    small_gain: float = 0.2
    hopeless: float = 3.0
    optimism: float = 2.0
    longest_step: float = 1.5
    differences: tuple[float, ...] = (1e-6, -1e-6, 1e-7, -1e-7, 1e-8, -1e-8, 1e-9, -1e-9, 1e-10, -1e-10)
    slow_difference: float = 1e-5
    dampings: tuple[float, ...] = (1e-4, 1e-2, 0.3, 10.0)


EFFORT = OptimiserSettings()
