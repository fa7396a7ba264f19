"""Sensors that correct: a frozen value each, saying what it reads (equation, Jacobian) and how it errs.

A reading is a vector of float64 in SI units and radians; NaN is a missing component. Every reading is
``h(state, parameters) + coloured error + white error``; the kernels of `navfilter.kernels.measurement` hold h and its
Jacobian.
"""

from navfilter.models.sensors.altitude import Altitude
from navfilter.models.sensors.attitude import Attitude
from navfilter.models.sensors.beams import DvlBeams
from navfilter.models.sensors.course import Course
from navfilter.models.sensors.heading import Heading
from navfilter.models.sensors.observable import Observable
from navfilter.models.sensors.odometer import Odometer
from navfilter.models.sensors.position import Depth, Position
from navfilter.models.sensors.ranges import Range
from navfilter.models.sensors.sensor import Sensor
from navfilter.models.sensors.usbl import Usbl
from navfilter.models.sensors.velocity import BodyVelocity, WaterVelocity, ZeroVelocity
from navfilter.models.sensors.zero_rate import ZeroRate

__all__ = [
    "Altitude",
    "Attitude",
    "BodyVelocity",
    "Course",
    "Depth",
    "DvlBeams",
    "Heading",
    "Observable",
    "Odometer",
    "Position",
    "Range",
    "Sensor",
    "Usbl",
    "WaterVelocity",
    "ZeroRate",
    "ZeroVelocity",
]
