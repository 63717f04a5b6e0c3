"""What every test folder shares."""

from __future__ import annotations

import os

from hypothesis import settings

# no deadline: a wall time says more about the machine than about the code
settings.register_profile("navbridge", deadline=None, derandomize=bool(os.environ.get("CI")))
settings.load_profile("navbridge")
