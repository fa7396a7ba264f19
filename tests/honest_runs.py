"""Whether the errors of many runs are as large as their covariances say."""

import numpy as np
from scipy.stats import chi2


def assert_honest(runs, *times_s, names=("position", "velocity"), least=1.0):
    """The sum of the normalised squared errors of all (mission, track) at an instant is one of chi-square, within its
    99.9 %; of its lower bound `least` is enough.
    """
    low, high = chi2.ppf([0.0005, 0.9995], 3 * len(runs))
    for time_s in times_s:
        sums = dict.fromkeys(names, 0.0)
        for mission, track in runs:
            at = int(np.searchsorted(track.time_s, time_s))
            figures = track.nees(track.errors(mission.truth))
            sums = {name: value + 3.0 * figures[name][at] for name, value in sums.items()}
        assert all(least * low < value < high for value in sums.values()), (time_s, sums, low, high)
