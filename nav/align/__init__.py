"""Alignment: finding the attitude at which navigation starts."""
