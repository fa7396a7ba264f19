"""What a series must hold before something is believed of it. Each number stands here once, with its unit and
reason.
"""

#: Known samples below which nothing is learnt (by choice: of fewer the prior says more than they do).
LEAST = 100
#: Known samples for each parameter of an order, below which it is not tried (by experience).
PER_PARAMETER = 20
#: States of the drift that a series may stand on, at most (a position by accelerometers): each takes a sample.
MOST_DRIFT = 3
#: What is larger is no residual of a sensor but rubbish on its line, and missing [m, m/s, rad]: its square overflows.
WILDEST = 1e12
#: Missing ticks in a row that are predicted through; after more the filter of the likelihood begins anew (by choice: a
#: second at 8 Hz).
LONGEST_GAP = 8
#: Innovations count up to so many standard deviations: white noise goes beyond them once in 16,000 samples.
CLIP = 4.0


def least_window(parameters: int) -> int:
    """Samples that a window must hold for a model of so many parameters ever to be learnt from it [1]."""
    return max(LEAST, PER_PARAMETER * (parameters + 1)) + MOST_DRIFT
