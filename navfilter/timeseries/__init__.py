"""Time series and ARMA models of them: fits, order selection, the online estimator, diagnostics, conversions."""

from navfilter.foundation.public_names import lazily

__getattr__, __dir__, __all__, _ = lazily(__name__, __file__)
