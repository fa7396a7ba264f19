"""A track as a table of pandas, and as it shows itself."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from navfilter.foundation import utc
from navfilter.foundation.display import often, span

if TYPE_CHECKING:
    import pandas as pd

    from navfilter.track.track import Track, TrackErrors

__all__ = ["errors_shown", "frame", "shown"]

Array = NDArray[np.float64]


def frame(track: Track) -> pd.DataFrame:
    """See `Track.to_frame`."""
    import pandas as pd

    sd = np.sqrt(np.diagonal(track.covariance, axis1=1, axis2=2))
    rpy, rpy_sd = np.degrees(track.attitude), np.degrees(track.attitude_sd())
    columns: dict[str, Array | pd.DatetimeIndex] = {"time_s": track.time_s}
    if track.time_utc is not None:
        columns["time_utc"] = pd.DatetimeIndex(track.time_utc, tz="UTC")
    columns |= {
        "latitude_deg": np.degrees(track.latitude),
        "longitude_deg": np.degrees(track.longitude),
        "height_m": track.height,
        "depth_m": -track.height,
    }
    axes = ("north", "east", "down")
    columns |= {f"velocity_{a}_m_s": track.velocity_n[:, i] for i, a in enumerate(axes)}
    columns |= {"roll_deg": rpy[:, 0], "pitch_deg": rpy[:, 1], "heading_deg": rpy[:, 2] % 360.0}
    columns |= {f"position_{a}_sd_m": sd[:, i] for i, a in enumerate(axes)}
    columns["position_north_east_cov_m2"] = track.covariance[:, 0, 1]
    columns |= {f"velocity_{a}_sd_m_s": sd[:, 3 + i] for i, a in enumerate(axes)}
    columns |= {f"{a}_sd_deg": rpy_sd[:, i] for i, a in enumerate(("roll", "pitch", "heading"))}
    if track.bounds is not None:
        columns |= {"protection_radius_m": track.bounds[:, 0], "heading_bound_deg": np.degrees(track.bounds[:, 1])}
    for i, name in enumerate(track.state_names):
        unit = track.state_units[i] if track.state_units else "1"
        factor = 180.0 / math.pi if unit.startswith("rad") else 1.0
        unit = unit.replace("rad", "deg")
        columns[f"{name}_{unit}"] = factor * track.states[:, i]
        columns[f"{name}_sd_{unit}"] = factor * track.states_sd[:, i]
    return pd.DataFrame(columns)


def shown(track: Track) -> tuple[str, dict[str, object]]:
    """Title and rows by which a track shows itself, at a prompt and in a notebook."""
    rows: dict[str, object] = {"mission": track.mission_name, "vehicle": track.vehicle.name, "rows": len(track)}
    if len(track):
        sd = np.sqrt(np.trace(track.covariance[-1, :2, :2]))
        rows |= {
            "begins": utc.date_text(track.time_s[0], track.epoch_utc_s),
            "mission time": f"{track.time_s[0]:.1f} to {track.time_s[-1]:.1f} s",
            "travelled": f"{track.distance_m:.0f} m",
            "ends at": f"{math.degrees(track.latitude[-1]):.6f}, {math.degrees(track.longitude[-1]):.6f} deg",
            "sd of position at the end": f"{sd:.2f} m",
        }
    for name, residuals in track.residuals.items():
        rows[name] = residuals.in_words
    rows["irregular"] = ", ".join(f"{count} {name}" for name, count in track.counts.items() if count) or None
    rows["learnt"] = ", ".join(track.adopted()) or None
    return f"Track, {track.label}", rows


def errors_shown(errors: TrackErrors) -> tuple[str, dict[str, object]]:
    """The same of its errors."""
    known = int(np.count_nonzero(np.isfinite(errors.horizontal)))
    rows: dict[str, object] = {"truth": f"at {known} of {len(errors.time_s)} rows"}
    rows["position"] = _in_words(errors.horizontal, "m, horizontal")
    rows["velocity"] = _in_words(np.linalg.norm(errors.velocity_n, axis=1), "m/s")
    rows["heading"] = _in_words(np.degrees(errors.heading), "deg")
    return f"TrackErrors{span(errors.time_s)}, {often(errors.time_s, 'rows')}", rows


def _in_words(errors: Array, unit: str) -> str | None:
    """Root mean square and largest of those that are known."""
    known = np.abs(errors[np.isfinite(errors)])
    if not len(known):
        return None
    return f"{math.sqrt(float(np.mean(known**2))):.3g} rms, {known.max():.3g} at most [{unit}]"
