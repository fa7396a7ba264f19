"""Faults: detectors, what they answer to a reading or sample, and in which order they are asked (`policy`)."""
