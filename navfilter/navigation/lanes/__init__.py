"""Vehicles with several inertial units: a navigator for each, and which of them is believed."""
