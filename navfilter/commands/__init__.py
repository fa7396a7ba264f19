"""Sub-commands of the command line that need more than a few lines, and what they share."""
