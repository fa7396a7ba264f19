"""What drives the state between corrections: an inertial unit, or attitude and body velocity."""

from navfilter.models.mechanisation.dead_reckoning import DeadReckoning
from navfilter.models.mechanisation.dead_reckoning_lane import DeadReckoningLane
from navfilter.models.mechanisation.imu import ACCEL_PRIOR, GYRO_PRIOR, Imu
from navfilter.models.mechanisation.mechanisation import DriveNoise, Mechanisation, Triple

__all__ = [
    "ACCEL_PRIOR",
    "GYRO_PRIOR",
    "DeadReckoning",
    "DeadReckoningLane",
    "DriveNoise",
    "Imu",
    "Mechanisation",
    "Triple",
]
