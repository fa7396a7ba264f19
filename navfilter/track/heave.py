"""Heave: what of the height is faster than the tide, the dive and the trim."""

import numpy as np
import scipy  # its parts are imported when they are first used: that takes a second

from navfilter.foundation.arrays import Array
from navfilter.track.track import Track


def heave(track: Track, period_s: float = 30.0) -> Array:
    """Height less its slow part, positive up [m], shape (n,).

    Parameters
    ----------
    track : Track
        Of a vehicle with an inertial unit, whose height has the waves in it; better a smoothed one. Its rows stand as
        densely as a wave needs.
    period_s : float
        Motion slower than this is not heave [s].

    Raises
    ------
    ValueError
        Without an inertial unit, for a track shorter than two periods, and for rows too far apart.

    Notes
    -----
    A Butterworth filter of the fourth order in all, run forward and backward over the whole track: it has no phase, as
    the delayed heave of a motion sensor has not either (Godhavn, 1998).
    """
    if not track.vehicle.drive.inertial:
        raise ValueError("heave is felt by an inertial unit; this vehicle has none.")
    length_s = float(track.time_s[-1] - track.time_s[0]) if len(track) else 0.0
    if length_s < 2.0 * period_s:
        raise ValueError(f"heave needs a track of two periods, {2.0 * period_s:g} s; this one has {length_s:g} s.")
    step_s = float(np.median(np.diff(track.time_s)))
    if step_s > 0.05 * period_s:
        raise ValueError(f"heave needs rows closer than {0.05 * period_s:g} s, found {step_s:g} s: --output-rate.")
    even = np.arange(track.time_s[0], track.time_s[-1] + 0.5 * step_s, step_s)
    height = np.interp(even, track.time_s, track.height)
    slow = scipy.signal.butter(2, 1.0 / period_s, "low", fs=1.0 / step_s, output="sos")
    padlen = min(even.size - 1, round(period_s / step_s))
    left = height - scipy.signal.sosfiltfilt(slow, height, padtype="odd", padlen=padlen)
    return np.asarray(np.interp(track.time_s, even, left))
