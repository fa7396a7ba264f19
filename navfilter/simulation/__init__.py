"""Missions with truth: exact motion, what every sensor would read on it, and how it errs."""
