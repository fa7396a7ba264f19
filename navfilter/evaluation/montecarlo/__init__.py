"""Monte Carlo campaigns: seeds -> missions -> runs -> statistics."""
