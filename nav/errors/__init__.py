"""How errors of an inertial navigator grow."""
