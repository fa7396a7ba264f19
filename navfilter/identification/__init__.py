"""Identify the error model of a recorded series: result, reading in plain words, figures, page."""
