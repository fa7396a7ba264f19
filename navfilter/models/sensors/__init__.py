"""Sensors that correct: a frozen value each, saying what it reads (equation, Jacobian) and how it errs.

A reading is a vector of float64 in SI units and radians; NaN is a missing component. Every reading is
``h(state, parameters) + coloured error + white error``; the kernels of `navfilter.kernels.measurement` hold h and its
Jacobian.
"""

from navfilter.models.sensors.beams import DvlBeams as DvlBeams
from navfilter.models.sensors.heading import Attitude as Attitude
from navfilter.models.sensors.heading import Heading as Heading
from navfilter.models.sensors.observable import Observable as Observable
from navfilter.models.sensors.position import Altitude as Altitude
from navfilter.models.sensors.position import Depth as Depth
from navfilter.models.sensors.position import Position as Position
from navfilter.models.sensors.ranges import Range as Range
from navfilter.models.sensors.ranges import Usbl as Usbl
from navfilter.models.sensors.sensor import Sensor as Sensor
from navfilter.models.sensors.velocity import BodyVelocity as BodyVelocity
from navfilter.models.sensors.velocity import Course as Course
from navfilter.models.sensors.velocity import Odometer as Odometer
from navfilter.models.sensors.velocity import WaterVelocity as WaterVelocity
from navfilter.models.sensors.velocity import ZeroRate as ZeroRate
from navfilter.models.sensors.velocity import ZeroVelocity as ZeroVelocity
