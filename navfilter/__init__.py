"""navfilter: under construction."""

from navfilter.arma import ArmaModel, forecast_arma, is_stable, log_s0_sd, simulate_arma
from navfilter.arma_algebra import BiasPlusWhite, add_arma, bias_plus_white, resample_arma, spectral_factor
