"""The processes that the ARMA estimators are tried on, and what an estimate loses in prediction."""

from __future__ import annotations

import numpy as np
from harness import Array

import navfilter as nf

GM2 = np.exp(-0.05)
Roots = tuple[list[complex], list[complex]]


def pairs(*polar: tuple[float, float]) -> list[complex]:
    """Conjugate pairs of roots by radius and angle."""
    return [r * np.exp(sign * 1j * angle) for r, angle in polar for sign in (1, -1)]


#: Poles and zeros of the ten models of the study that set the targets.
EFFICIENCY: dict[str, Roots] = {
    "AR1 .8": ([0.8], []),
    "MA1 -.6": ([], [0.6]),
    "ARMA11 .8, -.6": ([0.8], [0.6]),
    "ARMA11 .8, +.6": ([0.8], [-0.6]),
    "GPS-like AR2": ([0.972, -0.177], []),
    "GM1 .99 + white": ([0.99], [0.931]),
    "GM2 beta dt .05": ([GM2, GM2], [-0.26795]),
    "compass-like 4,2": ([0.97, 0.5, *pairs((0.9, 0.8))], [0.85, -0.3]),
    "band-pass 4,2": (pairs((0.98, 0.6), (0.9, 1.5)), [0.6, -0.5]),
    # 1/C - 1/2 is not positive real: A = 1 + .9q + .95q^2, C = 1 + 1.5q + .75q^2
    "non-SPR": (list(np.roots([1.0, 0.9, 0.95])), list(np.roots([1.0, 1.5, 0.75]))),
}
CHOSEN: dict[str, Roots] = {
    "white": ([], []),
    **{name: EFFICIENCY[name] for name in ("GPS-like AR2", "GM1 .99 + white", "compass-like 4,2")},
    "ARMA11 weak": ([0.972], [0.178]),
}


def coefficients(poles: list[complex], zeros: list[complex]) -> tuple[Array, Array]:
    """AR and MA coefficients of a model with these poles and zeros."""
    return np.atleast_1d(np.poly(poles)).real[1:], np.atleast_1d(np.poly(zeros)).real[1:]


FITTED: dict[str, tuple[Array, Array]] = {
    "(2,1)": (np.array([-1.6, 0.64]), np.array([0.3])),
    "(4,4)": (coefficients(pairs((0.97, 0.5), (0.8, 1.7)), [])[0], np.array([0.5, -0.3, 0.2, 0.1])),
    "(10,10)": coefficients(
        pairs((0.95, 0.3), (0.9, 0.8), (0.9, 1.3), (0.9, 1.8), (0.85, 2.4)),
        pairs((0.8, 0.55), (0.7, 1.05), (0.8, 1.55), (0.6, 2.1), (0.8, 2.8)),
    ),
}


def excess(ar: Array, ma: Array, true_ar: Array, true_ma: Array) -> float:
    """V/sd^2 - 1 of estimated coefficients: power of the response of (A^ C)/(C^ A) beyond its first term."""
    numerator = np.convolve(np.r_[1.0, ar], np.r_[1.0, true_ma])
    denominator = np.convolve(np.r_[1.0, ma], np.r_[1.0, true_ar])
    return nf.ArmaModel(denominator[1:], numerator[1:], 1.0).variance - 1.0
