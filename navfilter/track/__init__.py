"""The result of a run: state, covariance, residuals, error models in force; as a table and as a figure."""
