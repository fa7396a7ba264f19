"""Faults of clocks and time stamps."""
