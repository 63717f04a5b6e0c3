"""Inertial sensors: from pulses to increments of angle and velocity."""
