"""Sensors that correct: a frozen value each, saying what it reads (equation, Jacobian) and how it errs.

A reading is a vector of float64 in SI units and radians; NaN is a missing component. Every reading is
``h(state, parameters) + coloured error + white error``; the kernels of `navfilter.kernels.measurement` hold h and its
Jacobian.
"""

from navfilter.sensors.altitude import Altitude
from navfilter.sensors.attitude import Attitude
from navfilter.sensors.beams import DvlBeams
from navfilter.sensors.course import Course
from navfilter.sensors.heading import Heading
from navfilter.sensors.odometer import Odometer
from navfilter.sensors.position import Depth, Position
from navfilter.sensors.ranges import Range
from navfilter.sensors.sensor import Sensor
from navfilter.sensors.turning import ZeroRate
from navfilter.sensors.usbl import Usbl
from navfilter.sensors.velocity import BodyVelocity, WaterVelocity, ZeroVelocity

__all__ = [
    "Altitude",
    "Attitude",
    "BodyVelocity",
    "Course",
    "Depth",
    "DvlBeams",
    "Heading",
    "Odometer",
    "Position",
    "Range",
    "Sensor",
    "Usbl",
    "WaterVelocity",
    "ZeroRate",
    "ZeroVelocity",
]
