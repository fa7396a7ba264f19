"""Replay: a loop over a recorded mission through the navigator; warm-up; fixes that are held out."""
