"""The error-state filter: the state and its covariance, what moves and corrects them, and what a run leaves behind."""
