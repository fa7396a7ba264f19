"""A track in the figures of surveyors: CEP50, R95, vertical uncertainty, and what the orders of IHO S-44 ask for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cache
from typing import Any

import numpy as np
from scipy.special import ndtri

from navfilter.foundation.arrays import Array
from navfilter.track.heave import heave
from navfilter.track.track import Track

#: Orders of IHO S-44 (edition 6) -> total horizontal and vertical uncertainty that it allows at depth 0, 95 % [m]. In
#: deep water they allow more; 1a and 1b are alike in both.
ORDERS = {"exclusive": (1.0, 0.15), "special": (2.0, 0.25), "1a/1b": (5.0, 0.5), "2": (20.0, 1.0)}


@dataclass(frozen=True)
class SurveyFigures:
    """Predicted uncertainty along a track.

    Attributes
    ----------
    cep50_mean_m, cep50_most_m : float
        Radius of the circle that holds the horizontal error in one case of two [m].
    r95_mean_m, r95_most_m : float
        The same in 95 of 100 cases: what S-44 calls THU [m].
    tvu_mean_m, tvu_most_m : float
        Bound of the vertical error in 95 of 100 cases [m].
    orders : dict of str to float
        Share of the way on which the vehicle's position meets an order, in per cent.
    horizontal : dict of str to float
        The same of the horizontal position alone: all there is of a mission without depths or heights.
    heave_rms_m : float or None
        Rms of `navfilter.track.heave.heave` [m]; None without an inertial unit, and for rows too far apart.
    """

    cep50_mean_m: float
    cep50_most_m: float
    r95_mean_m: float
    r95_most_m: float
    tvu_mean_m: float
    tvu_most_m: float
    orders: dict[str, float]
    horizontal: dict[str, float]
    heave_rms_m: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """As plain values, for summary.json."""
        return asdict(self)

    def lines(self) -> Iterator[str]:
        """The same in words."""
        yield (
            f"CEP50 {self.cep50_mean_m:.2f} m on average ({self.cep50_most_m:.2f} m at most), R95 "
            f"{self.r95_mean_m:.2f} m ({self.r95_most_m:.2f}), vertical 95 % {self.tvu_mean_m:.2f} m "
            f"({self.tvu_most_m:.2f})"
        )
        if self.heave_rms_m is not None:
            yield f"heave (up and down faster than 30 s) {self.heave_rms_m:.3f} m rms"
        both, alone = (
            ", ".join(f"{name} {share:.0f} %" for name, share in shares.items())
            for shares in (self.orders, self.horizontal)
        )
        both += f"; horizontally alone: {alone}" * (alone != both)
        yield f"of the way within the orders of IHO S-44 (position of the vehicle alone, limits of depth 0): {both}"


def survey_figures(track: Track) -> SurveyFigures:
    """Figures of a track from its covariance; only as good as that is honest.

    Parameters
    ----------
    track : Track
    """
    cep50, r95 = (radius(track.covariance[:, :2, :2], share) for share in (0.5, 0.95))
    vertical = float(ndtri(0.975)) * np.sqrt(np.maximum(track.covariance[:, 2, 2], 0.0))
    way = np.diff(track.travelled(), append=track.distance_m)
    way = way if way.sum() > 0.0 else np.ones(len(track))
    level = {name: r95 <= thu for name, (thu, _) in ORDERS.items()}
    whole = {name: level[name] & (vertical <= tvu) for name, (_, tvu) in ORDERS.items()}
    orders, horizontal = (
        {name: float(100.0 * way[met].sum() / way.sum()) for name, met in each.items()} for each in (whole, level)
    )
    return SurveyFigures(
        *(float(cep50.mean()), float(cep50.max())),
        *(float(r95.mean()), float(r95.max())),
        *(float(vertical.mean()), float(vertical.max())),
        orders=orders,
        horizontal=horizontal,
        heave_rms_m=_heave_rms_m(track),
    )


def _heave_rms_m(track: Track) -> float | None:
    try:
        return float(np.sqrt(np.mean(heave(track) ** 2)))
    except ValueError:  # nobody asked for it
        return None


def radius(covariance: Array, share: float) -> Array:
    """Radius of the circle around a horizontal position that holds it with a given probability [m].

    Parameters
    ----------
    covariance : ndarray, shape (n, 2, 2)
    share : float
        The probability.

    Examples
    --------
    >>> radius(np.eye(2)[np.newaxis], 0.95).round(3).tolist()
    [2.448]
    """
    small, large = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance), 0.0)).T
    ratio = np.divide(small, large, out=np.zeros_like(small), where=large > 0.0)
    ratios, radii = _radii(share)
    return np.asarray(large * np.interp(ratio, ratios, radii))


@cache
def _radii(share: float) -> tuple[Array, Array]:
    """Ratio of the two standard deviations, and the radius for that in units of the larger one.

    Notes
    -----
    In polar coordinates the density can be integrated along the radius; along the angle the rule of rectangles is exact
    to all digits for a smooth function of a whole turn.
    """
    ratios = np.linspace(0.0, 1.0, 101)
    angle = np.linspace(0.0, 2.0 * np.pi, 4000, endpoint=False)
    radii = np.empty(ratios.size)
    radii[0] = ndtri(0.5 * (1.0 + share))  # all along one line
    for k, ratio in enumerate(ratios[1:], start=1):
        weight = np.cos(angle) ** 2 + (np.sin(angle) / ratio) ** 2
        low, high = 0.0, 5.0
        for _ in range(50):
            middle = 0.5 * (low + high)
            inside = np.mean(-np.expm1(-0.5 * weight * middle**2) / weight) / ratio
            low, high = (middle, high) if inside < share else (low, middle)
        radii[k] = 0.5 * (low + high)
    return ratios, radii
