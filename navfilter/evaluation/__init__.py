"""Judging runs: error-model comparisons, consistency, baselines and campaigns."""
