"""Constants, time, argument checks, frozen values, chi-square limits, state as values: what every folder uses."""
