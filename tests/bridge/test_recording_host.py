"""What is recorded of the machine that computed a solution."""

from __future__ import annotations

import json

import pytest

from bridge.recording_host import differences, environment


def test_a_machine_does_not_differ_from_itself() -> None:
    assert differences(environment()) == []


def test_variables_that_choose_kernels_are_recorded_and_others_are_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before = environment()
    monkeypatch.setenv("OPENBLAS_CORETYPE", "another")
    monkeypatch.setenv("A_PASSWORD", "secret")
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/elsewhere")
    now = environment()
    assert differences(before) == ["variables"]
    assert json.loads(now["variables"])["OPENBLAS_CORETYPE"] == "another"
    assert not {"A_PASSWORD", "NUMBA_CACHE_DIR"} & set(json.loads(now["variables"]))
