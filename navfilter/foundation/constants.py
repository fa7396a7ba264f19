"""Numbers of physics that several modules need, each once."""

#: Standard gravity [m/s^2] (3rd General Conference on Weights and Measures, 1901): what files and data sheets mean by
#: g.
STANDARD_GRAVITY = 9.80665
#: A thousandth of it [m/s^2], the unit of accelerometer biases.
MILLI_G = 9.80665e-3
#: Gravity somewhere on Earth [m/s^2], where only its size counts: it differs by 0.5 % from the equator to the poles.
#: Where the place is known, the filter computes gravity from latitude and height instead.
ROUND_GRAVITY = 9.81
#: Square root of an hour [sqrt(s)]: a random walk of density d gets ``d * ROOT_HOUR`` far in an hour, one standard
#: deviation.
ROOT_HOUR = 60.0
