"""navfilter: under construction."""
