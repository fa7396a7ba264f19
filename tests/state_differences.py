"""Where two states differ."""

import dataclasses
import math
from typing import Any

import numpy as np


def differences(one: Any, other: Any, tolerance: float = 0.0, where: str = "") -> list[str]:
    """Where two states differ: paths, with the largest difference of arrays; empty when they are the same.

    Parameters
    ----------
    one, other
        Of the same class.
    tolerance : float
        Numbers may differ by so much.
    where : str
        Path of the two, for the answer.
    """
    if type(one) is not type(other):
        return [f"{where}: {type(one).__name__} and {type(other).__name__}"]
    if isinstance(one, np.ndarray):
        if one.shape != other.shape:
            return [f"{where}: shapes {one.shape} and {other.shape}"]
        if np.allclose(one, other, rtol=0.0, atol=tolerance, equal_nan=True):
            return []
        return [f"{where}: {np.nanmax(np.abs(one - other)):.3g}"]
    if isinstance(one, float):
        same = one == other or abs(one - other) <= tolerance or (math.isnan(one) and math.isnan(other))
        return [] if same else [f"{where}: {one} and {other}"]
    if isinstance(one, list | tuple) and len(one) == len(other):
        return [
            d
            for i, (a, b) in enumerate(zip(one, other, strict=True))
            for d in differences(a, b, tolerance, f"{where}[{i}]")
        ]
    if isinstance(one, dict) and one.keys() == other.keys():
        return [d for key, item in one.items() for d in differences(item, other[key], tolerance, f"{where}[{key!r}]")]
    if dataclasses.is_dataclass(one):
        names = [f.name for f in dataclasses.fields(one)]
        return [d for n in names for d in differences(getattr(one, n), getattr(other, n), tolerance, f"{where}.{n}")]
    return [] if one == other else [f"{where}: {one!r} and {other!r}"]
