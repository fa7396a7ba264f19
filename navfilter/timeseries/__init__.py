"""Time series and ARMA models of them: fits, order selection, the online estimator, diagnostics, conversions."""

import importlib
from typing import TYPE_CHECKING, Any

from navfilter.timeseries.model import ArmaModel, forecast_arma, log_s0_sd, simulate_arma
from navfilter.timeseries.roots import is_stable

#: Public names by the module that holds them; imported when first used.
_FACE = {
    "diagnostics": "Whiteness allan_deviation allan_edf cross_correlation",
    "fit": "ArmaFit",
    "gauss_markov": "GaussMarkovFit correlation_product fit_gauss_markov gauss_markov_arma",
    "initial_values": "burg hannan_rissanen yule_walker",
    "online.order_bank": "ArmaBank",
    "online.preprocessing": "FrontEnd",
    "order": "OrderTable",
    "periodic_motion": "find_motion_band subtract_motion",
    "polynomials": "BiasPlusWhite add_arma bias_plus_white resample_arma split_bias",
    "spectral": "spectral_factor",
}
_HOME = {name: module for module, names in _FACE.items() for name in names.split()}
__all__ = sorted([*_HOME, "ArmaModel", "forecast_arma", "is_stable", "log_s0_sd", "simulate_arma"])

# For checkers and editors, which do not run what follows.
if TYPE_CHECKING:
    from navfilter.timeseries.diagnostics import Whiteness as Whiteness
    from navfilter.timeseries.diagnostics import allan_deviation as allan_deviation
    from navfilter.timeseries.diagnostics import allan_edf as allan_edf
    from navfilter.timeseries.diagnostics import cross_correlation as cross_correlation
    from navfilter.timeseries.fit import ArmaFit as ArmaFit
    from navfilter.timeseries.gauss_markov import GaussMarkovFit as GaussMarkovFit
    from navfilter.timeseries.gauss_markov import correlation_product as correlation_product
    from navfilter.timeseries.gauss_markov import fit_gauss_markov as fit_gauss_markov
    from navfilter.timeseries.gauss_markov import gauss_markov_arma as gauss_markov_arma
    from navfilter.timeseries.initial_values import burg as burg
    from navfilter.timeseries.initial_values import hannan_rissanen as hannan_rissanen
    from navfilter.timeseries.initial_values import yule_walker as yule_walker
    from navfilter.timeseries.online.order_bank import ArmaBank as ArmaBank
    from navfilter.timeseries.online.preprocessing import FrontEnd as FrontEnd
    from navfilter.timeseries.order import OrderTable as OrderTable
    from navfilter.timeseries.periodic_motion import find_motion_band as find_motion_band
    from navfilter.timeseries.periodic_motion import subtract_motion as subtract_motion
    from navfilter.timeseries.polynomials import BiasPlusWhite as BiasPlusWhite
    from navfilter.timeseries.polynomials import add_arma as add_arma
    from navfilter.timeseries.polynomials import bias_plus_white as bias_plus_white
    from navfilter.timeseries.polynomials import resample_arma as resample_arma
    from navfilter.timeseries.polynomials import split_bias as split_bias
    from navfilter.timeseries.spectral import spectral_factor as spectral_factor


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'navfilter.timeseries' has no attribute '{name}'")
    value = getattr(importlib.import_module(f"navfilter.timeseries.{_HOME[name]}"), name)
    globals()[name] = value
    return value
