"""The error-state filter: states, covariance, measurements, and the history that late data needs."""
