"""Calibration of inertial units on a turntable: from counts in known attitudes to coefficients."""
