"""What users describe: error models, sensors, mechanisations, vehicle, start, mission; and what runs report."""
