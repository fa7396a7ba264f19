"""What drives the state between corrections: an inertial unit, or attitude and body velocity."""

from navfilter.models.mechanisation.dead_reckoning import DeadReckoning as DeadReckoning
from navfilter.models.mechanisation.dead_reckoning import DeadReckoningLane as DeadReckoningLane
from navfilter.models.mechanisation.mechanisation import ACCEL_PRIOR as ACCEL_PRIOR
from navfilter.models.mechanisation.mechanisation import GYRO_PRIOR as GYRO_PRIOR
from navfilter.models.mechanisation.mechanisation import DriveNoise as DriveNoise
from navfilter.models.mechanisation.mechanisation import Imu as Imu
from navfilter.models.mechanisation.mechanisation import Mechanisation as Mechanisation
from navfilter.models.mechanisation.mechanisation import Triple as Triple
