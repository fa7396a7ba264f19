"""Constants of a vehicle from missions: clocks, lever arms, scales, mountings, deviation."""
