"""Packaged mappings, with the configurations and calibrations they name."""
