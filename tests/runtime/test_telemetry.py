"""onnxruntime's telemetry setting. Its effect is tested in tests/reliability/test_side_effects.py."""

import os
import sys
from types import SimpleNamespace

import pytest

from duospacenet.runtime.telemetry import VARIABLE, disable_telemetry


@pytest.fixture
def calls(monkeypatch) -> list[str]:
    """The calls of an onnxruntime that was imported before duospacenet."""
    calls: list[str] = []
    loaded = SimpleNamespace(disable_telemetry_events=lambda: calls.append("disable"))
    monkeypatch.setitem(sys.modules, "onnxruntime", loaded)
    monkeypatch.setenv(VARIABLE, "0")  # so that the test run's own value is restored
    return calls


def test_an_onnxruntime_that_was_imported_before_records_no_further_events(calls, monkeypatch):
    monkeypatch.delenv(VARIABLE)
    disable_telemetry()
    assert calls == ["disable"]
    assert os.environ[VARIABLE] == "1"


def test_a_users_choice_is_kept(calls):
    disable_telemetry()
    assert calls == []
    assert os.environ[VARIABLE] == "0"


def test_a_build_of_onnxruntime_without_telemetry_is_accepted(calls, monkeypatch):
    monkeypatch.delenv(VARIABLE)
    monkeypatch.setitem(sys.modules, "onnxruntime", SimpleNamespace())
    disable_telemetry()
    assert os.environ[VARIABLE] == "1"
