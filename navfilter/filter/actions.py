"""The only verbs by which anybody changes a filter: a monitor yields them, and `Filter.apply` does them at once.

A rule that yields an action goes on when it has been done: it then reads the new state.
"""

from typing import Any, NamedTuple

from navfilter.filter.events import Event
from navfilter.filter.model_change import Change
from navfilter.filter.sensor_channel import Channel
from navfilter.foundation.arrays import Array


class Inflate(NamedTuple):
    """Add to the covariance: ``P[rows, columns] += covariance``.

    Attributes
    ----------
    rows, columns : index
        Places of states, as arrays or slices index a matrix.
    covariance : float or ndarray
    """

    rows: Any
    columns: Any
    covariance: Any


class Transform(NamedTuple):
    """Replace velocity and attitude: of the error state ``M x + w``, ``w ~ N(0, N)``, is left.

    Attributes
    ----------
    velocity_n : ndarray, shape (3,)
    C_nb : ndarray, shape (3, 3)
    M, N : ndarray, shape (n, n)
    """

    velocity_n: Array
    C_nb: Array
    M: Array
    N: Array


class TurnHeading(NamedTuple):
    """Turn the heading, as by a reading of a compass.

    Attributes
    ----------
    compass : Channel
    angle, variance : float
        [rad], [rad^2].
    """

    compass: Channel
    angle: float
    variance: float


class MovePosition(NamedTuple):
    """Move the nominal position north and east [m]; its covariance stays."""

    north_m: float
    east_m: float


class Correct(NamedTuple):
    """Take an estimated error into the state, and open its covariance.

    Attributes
    ----------
    error : ndarray, shape (n,)
    covariance : ndarray, shape (n, n)
        Is added.
    """

    error: Array
    covariance: Array


class MoveError(NamedTuple):
    """Add to the estimate of an error state: ``x[place] += by``."""

    place: int
    by: float


class Adopt(NamedTuple):
    """Put another error model in force."""

    change: Change


class Readmit(NamedTuple):
    """Correct by the reading that was refused last, now that the covariance lets it in, without a gate.

    Attributes
    ----------
    channel : Channel
    residual : ndarray, shape (axes,)
        As the update wants it, which takes the coloured error off again.
    """

    channel: Channel
    residual: Array


class Fold(NamedTuple):
    """Take the transition of the samples since the last fold into the covariance."""


class Reweigh(NamedTuple):
    """Believe the axes of the inertial unit as far as the monitor says now."""


class RestartRest(NamedTuple):
    """Begin the means anew by which rest is detected."""


class AxisCondition(NamedTuple):
    """Record that an axis of the inertial unit is in another condition from a time on [s]."""

    time_s: float
    axis: str
    condition: str


class Count(NamedTuple):
    """Count an irregularity, see `navfilter.models.health.Health`."""

    name: str
    times: int = 1


class Announce(NamedTuple):
    """Tell those who listen to the filter of an event."""

    event: Event


Action = (
    Inflate
    | Transform
    | TurnHeading
    | MovePosition
    | Correct
    | MoveError
    | Adopt
    | Readmit
    | Fold
    | Reweigh
    | RestartRest
    | AxisCondition
    | Count
    | Announce
)
