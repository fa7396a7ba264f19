"""What of the state a kind of sensor observes: rules ask for this, and not for a class."""

from enum import Enum


class Observable(Enum):
    """What of the state a sensor observes.

    Attributes
    ----------
    corrects : str
        What of the state its readings bound: "position", "depth", "heading", "velocity", or nothing.
    north : int or None
        Which component of the error is that of a heading.

    Examples
    --------
    >>> Observable.ATTITUDE.corrects, Observable.ATTITUDE.north
    ('heading', 2)
    """

    #: Nothing that the program has a rule for: a kind of its own.
    NONE = ("none", "", None)
    #: Latitude, longitude and height.
    FIX = ("fix", "position", None)
    #: Height by a gauge, such as a pressure sensor.
    HEIGHT = ("height", "depth", None)
    #: Height above a bottom.
    ALTITUDE = ("altitude", "depth", None)
    #: Distance, and perhaps direction, to a beacon or ship.
    RANGE = ("range", "position", None)
    HEADING = ("heading", "heading", 0)
    #: Roll, pitch and heading.
    ATTITUDE = ("attitude", "heading", 2)
    #: Velocity over ground in axes of the body, through the heading.
    VELOCITY_BODY = ("velocity-body", "velocity", None)
    #: Velocity through the water in axes of the body.
    VELOCITY_WATER = ("velocity-water", "velocity", None)
    #: Velocity in north, east and down.
    VELOCITY_NED = ("velocity-ned", "velocity", None)
    #: Angular rate.
    RATE = ("rate", "", None)

    def __init__(self, name: str, corrects: str, north: int | None) -> None:
        self.corrects, self.north = corrects, north

    @property
    def in_body_axes(self) -> bool:
        """Whether it is a velocity that is seen through the heading."""
        return self in (Observable.VELOCITY_BODY, Observable.VELOCITY_WATER)
