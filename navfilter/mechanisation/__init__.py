"""What drives the state between corrections: an inertial unit, or attitude and body velocity."""

from navfilter.mechanisation.coasting import Coasting
from navfilter.mechanisation.dead_reckoning import DeadReckoning
from navfilter.mechanisation.imu import ACCEL_PRIOR, GYRO_PRIOR, Imu
from navfilter.mechanisation.mechanisation import DriveNoise, Mechanisation, Triple

__all__ = ["ACCEL_PRIOR", "GYRO_PRIOR", "Coasting", "DeadReckoning", "DriveNoise", "Imu", "Mechanisation", "Triple"]
