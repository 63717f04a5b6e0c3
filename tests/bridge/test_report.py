"""What a run says to the person in front of it."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from numba import config

from bridge.report import explain_wait


def test_a_wait_for_the_compiler_is_explained_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path / "kernels"))
    said = io.StringIO()
    explain_wait(said)
    assert said.getvalue().startswith("compiling")
    (tmp_path / "kernels" / "strapdown").mkdir(parents=True)
    (tmp_path / "kernels" / "strapdown" / "step.nbi").touch()
    again = io.StringIO()
    explain_wait(again)
    assert again.getvalue() == ""
