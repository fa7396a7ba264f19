"""navfilter: under construction."""

from navfilter.arma import ArmaModel, forecast_arma, is_stable, log_s0_sd, simulate_arma
from navfilter.arma_algebra import BiasPlusWhite, add_arma, bias_plus_white, resample_arma, spectral_factor
from navfilter.diagnostics import Whiteness, acf, allan_deviation, cross_correlation, pacf, whiteness
from navfilter.fit import ArmaFit, fit_arma
from navfilter.gauss_markov import GaussMarkovFit, correlation_product, fit_gauss_markov, gauss_markov_arma
from navfilter.starts import burg, hannan_rissanen, yule_walker
