"""The navigator, its history of measurements, how it is run live and over recordings, and its snapshots."""
