"""What a series must hold before something is believed of it. Each number stands here once, with its unit and
reason.
"""

__all__ = ["CLIP", "CYCLES", "LEAST", "LONGEST_GAP", "PER_PARAMETER"]

#: Known samples below which nothing is learnt: the whiteness gate needs a few times its 20 lags, and BIC is asymptotic
#: (by experience).
LEAST = 200
#: Known samples for each parameter of an order, below which it is not tried (by experience).
PER_PARAMETER = 20
#: A process that a series holds fewer times than this, by its time constant, cannot be told from drift or bias.
#: Measured while a window fills: such a process is found too quick, its S(0) 4 to 17 times too small.
CYCLES = 10.0
#: Missing ticks in a row that are predicted through; after more the filter of the likelihood begins anew (by choice: a
#: second at 8 Hz).
LONGEST_GAP = 8
#: Innovations count up to so many standard deviations: white noise goes beyond them once in 16,000 samples.
CLIP = 4.0
