"""Integration of inertial increments: attitude, velocity and position of one local-level frame."""
