"""The Gaussian belief: Kalman, extended and unscented filters."""
