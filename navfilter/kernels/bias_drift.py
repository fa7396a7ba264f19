"""Looks at the biases of an inertial unit's gyros, see `navfilter.faults.imu.bias_drift`.

A look is a row with the columns below; what is kept, `looks` (LOOKS, COLUMNS), holds the latest last, and NaN where
there is none.
"""

import math

from navfilter.kernels.compiling.decorators import apart, njit

#: Of kernels that allocate nothing: numba is not to count references to arrays, see `navfilter.kernels`.
UNCOUNTED: dict = {"_nrt": False}

# Time, latitude and longitude, how often the attitude had been set anew; estimates of the three biases, and their
# variances; NIS per component of the readings just before; heading by the compass, and that less what the gyros have
# turned (NaN: there is none).
TIME_S, LATITUDE, LONGITUDE, ANEW, BIAS, VARIANCE, NIS, HEADING, APART, COLUMNS = 0, 1, 2, 3, 4, 7, 10, 11, 12, 13
# Of each gyro: place of its bias among all states, what its random walk adds to the variance in a second, and by which
# variance it may move in any case. Without columns where not all gyros have one.
PLACE, WALK, LEAST = range(3)
LIMIT = 36.0  # a change beyond so many times its variance: six standard deviations


@apart
@njit(cache=True, error_model="numpy", **UNCOUNTED)
def largest_change(looks, now, walk, begin):
    """How far a bias has moved at most since one of the looks (k, COLUMNS), the latest last: the square of that over
    its variance. That is what it has lost of its own meanwhile, and its walk (3,) has added in so many seconds, as much
    larger as the mean NIS since then, and `begin` (3,), which it may move by in any case.
    """
    nis, count, most = now[NIS], 1, 0.0
    for k in range(looks.shape[0] - 1, -1, -1):
        nis += looks[k, NIS]
        count += 1
        if math.isnan(nis):
            break
        for i in range(3):
            added = walk[i] * (now[TIME_S] - looks[k, TIME_S])
            lost = max(looks[k, VARIANCE + i] + added - now[VARIANCE + i], 0.0)
            moved = now[BIAS + i] - looks[k, BIAS + i]
            most = max(most, moved * moved / max(lost * max(nis / count, 1.0) + begin[i], 1e-300))
    return most


@apart
@njit(cache=True, error_model="numpy", **UNCOUNTED)
def compare_estimates(looks, now, gyros, x, P, calm):
    """Complete a look with the biases, hold it against those before, and put it behind them; True, and nothing is put
    there, where one has moved by more than it may.

    gyros (3, 3 or 0): see the head of this file. calm: no axis is left out, or soon will be; else, and where anything
    but readings and time has changed the variances, it is the first look.
    """
    last = looks.shape[0] - 1
    if gyros.shape[1] > 0:
        calm = calm and now[ANEW] == looks[last, ANEW]
        for i in range(3):
            place = int(gyros[PLACE, i])
            now[BIAS + i], now[VARIANCE + i] = x[place - 9], P[place, place]
            added = gyros[WALK, i] * (now[TIME_S] - looks[last, TIME_S])
            calm = calm and now[VARIANCE + i] <= 1.001 * (looks[last, VARIANCE + i] + added)
        if not calm:
            for k in range(looks.shape[0]):
                for j in range(COLUMNS):
                    looks[k, j] = math.nan
        if largest_change(looks, now, gyros[WALK], gyros[LEAST]) > LIMIT:
            return True
    for k in range(last):
        for j in range(COLUMNS):
            looks[k, j] = looks[k + 1, j]
    for j in range(COLUMNS):
        looks[last, j] = now[j]
    return False
