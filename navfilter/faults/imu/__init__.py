"""Faults of an inertial unit."""
