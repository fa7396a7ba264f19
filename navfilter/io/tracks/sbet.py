"""track.sbet: Applanix's "smoothed best estimate of trajectory", as survey software reads it.

Records of 17 float64, little-endian: GPS seconds of the week; latitude, longitude [rad], height above the ellipsoid
[m]; velocity along x, y, z of the wander frame [m/s], roll, pitch, platform heading, wander angle [rad]; acceleration
and angular rate along the body's axes [m/s^2], [rad/s]. The wander angle is zero, so that x, y, z are north, east,
down, and the platform heading is the true one. Seconds count on through the end of a week.

A track has no accelerations and rates: they are the mean ones from each row to the next.
"""

from pathlib import Path

import numpy as np

from navfilter.foundation import utc
from navfilter.foundation.arrays import Array
from navfilter.foundation.atomic_files import pieces, replacing_binary
from navfilter.models.mission import Mission
from navfilter.models.state import matrix_from_euler, rotation_vector, wrap
from navfilter.track.track import Track

_WEEK_NS = 7 * 86400 * 10**9
#: 1980-01-06, when GPS time began and was UTC [s since 1970].
_GPS_EPOCH_S = 315964800
#: From when on GPS is how far ahead of UTC [s since 1970, s]: the leap seconds since then (IERS Bulletin C).
_LEAPS = (
    (1136073600, 14),  # 2006-01-01
    (1230768000, 15),  # 2009-01-01
    (1341100800, 16),  # 2012-07-01
    (1435708800, 17),  # 2015-07-01
    (1483228800, 18),  # 2017-01-01
)


def write(track: Track, path: Path, mission: Mission | None = None) -> None:
    """The track."""
    time_s = gps_seconds_of_week(track)
    with replacing_binary(path) as file:
        for rows in pieces(len(track)):
            records = np.zeros((rows.stop - rows.start, 17), dtype="<f8")
            records[:, 0] = time_s[rows]
            records[:, 1], records[:, 2] = track.latitude[rows], wrap(track.longitude[rows])
            records[:, 3] = track.height[rows]
            records[:, 4:7], records[:, 7:10] = track.velocity_n[rows], track.attitude[rows]
            records[:, 11:] = _mean_motion(track, rows)
            file.write(records.tobytes())


def gps_seconds_of_week(track: Track) -> Array:
    """Times of a track as GPS seconds of the week in which it begins, shape (n,).

    Raises
    ------
    ValueError
        For a track before 2006, whose leap seconds are not known here.
    """
    stamps = utc.nanoseconds(track.time_s, track.epoch_utc_s)
    begin_s = int(stamps[0]) // 10**9
    leap = max((seconds for since, seconds in _LEAPS if begin_s >= since), default=None)
    if leap is None:
        date = utc.date_text(track.time_s[0], track.epoch_utc_s)
        raise ValueError(f"this track begins at {date}; GPS time is known here from 2006 on. Check epoch.")
    since_gps = stamps - (_GPS_EPOCH_S - leap) * 10**9
    return (since_gps - since_gps[0] // _WEEK_NS * _WEEK_NS) * 1e-9


def _mean_motion(track: Track, rows: slice) -> Array:
    """Mean acceleration and angular rate in the body from each row to the next, (m, 6); of the last one again those
    before it, of a single one zeros.
    """
    if len(track) < 2:
        return np.zeros((1, 6))
    begin = np.minimum(np.arange(rows.start, rows.stop), len(track) - 2)
    step = (track.time_s[begin + 1] - track.time_s[begin])[:, np.newaxis]
    C, after = (matrix_from_euler(*track.attitude[row].T) for row in (begin, begin + 1))
    back = np.swapaxes(C, 1, 2)
    change = np.einsum("nij,nj->ni", back, track.velocity_n[begin + 1] - track.velocity_n[begin])
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(step > 0.0, np.column_stack([change, rotation_vector(back @ after)]) / step, 0.0)
