"""A track in the formats of other programs: one module each, and one table of them (`formats`)."""
