"""ARMA error models from series: the model value, batch fits and order selection, the online estimator and its bank of
orders.
"""

from navfilter.timeseries.model import ArmaModel, forecast_arma, log_s0_sd, simulate_arma
from navfilter.timeseries.roots import is_stable

__all__ = ["ArmaModel", "forecast_arma", "is_stable", "log_s0_sd", "simulate_arma"]
