"""How the sensors of a scenario really err, as far as that is an error model: what an oracle is told."""

from __future__ import annotations

import math

from navfilter.models.error_models import ErrorModel, White, per_axis
from navfilter.models.vehicle import Vehicle
from navfilter.simulation.faults import Changing, Faults
from navfilter.simulation.scenarios import SCENARIOS


def true_vehicle(name: str, duration_s: float | None = None) -> Vehicle | None:
    """The vehicle of a scenario as it really is.

    Parameters
    ----------
    name : str
        Key of `navfilter.simulation.scenarios.SCENARIOS`.
    duration_s : float, optional
        As for `simulate_scenario`.

    Returns
    -------
    Vehicle or None
        With the true error models of the sensors, rounding as white noise of its step over sqrt(12) beside them (Widrow
        & Kollar, 2008, sec. 1.2). None where the description is the truth. An error that changes during the mission is
        no model; such a sensor keeps the description's.

    Raises
    ------
    ValueError
        For an unknown name.

    Examples
    --------
    >>> type(true_vehicle("oscillating").sensors["compass"].error).__name__, true_vehicle("lawnmower")
    ('Sum', None)
    """
    if name not in SCENARIOS:
        raise ValueError(f'There is no scenario "{name}". Scenarios: {", ".join(SCENARIOS)}.')
    scenario = SCENARIOS[name]
    vehicle = scenario.vehicle()
    models: dict[str, ErrorModel | tuple[ErrorModel, ...]] = {}
    for key, fault in scenario.faults(scenario.duration_s if duration_s is None else duration_s).items():
        if fault.true_error is not None and not isinstance(fault.true_error, Changing):
            axes = vehicle.sensors[key].axes if key in vehicle.sensors else 3
            each = tuple(_rounded(model, fault) for model in per_axis(fault.true_error, axes, key))
            models[key] = each if len(each) > 1 else each[0]
    return vehicle.with_error(**models) if models else None


def _rounded(model: ErrorModel, fault: Faults) -> ErrorModel:
    step = fault.quantisation if isinstance(fault.quantisation, float | int) else max(fault.quantisation)
    if not step:
        return model
    return model + White(sd=step / math.sqrt(12.0))
