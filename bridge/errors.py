"""The exceptions a user of the bridge can meet.

NavbridgeError
├── ConfigError      a configuration, mapping, calibration or scenario file is wrong
├── SourceError      a bus or link cannot be opened or is gone
├── CaptureError     a capture is missing, foreign or damaged beyond reading
├── CalibrationError a turntable did not do what its plan says, or the plan does not show everything
└── ReplayMismatch   a replay gave another digest than the one expected
"""

from __future__ import annotations


class NavbridgeError(Exception):
    """Base of all; its text is one line that says what to do."""

    exit_status = 1


class ConfigError(NavbridgeError):
    """A configuration names something that is not there or not allowed."""

    exit_status = 2


class SourceError(NavbridgeError):
    """A bus or link cannot be opened, or went away for good."""


class CaptureError(NavbridgeError):
    """A capture cannot be read."""


class CalibrationError(NavbridgeError):
    """Captures and plan do not agree, or do not show every coefficient."""


class ReplayMismatch(NavbridgeError):
    """The digest of a replay differs from the one recorded or asked for."""
