"""Checks that every row of the reliability list has a test in this folder. `pytest -k a7_` runs the tests of A7."""

import re
from pathlib import Path

import pytest

ROWS = [
    f"{kind}{number}" for kind, count in {"a": 10, "t": 8, "s": 5, "p": 10}.items() for number in range(1, count + 1)
] + ["a12", "a13", "t9", "t10", "t11", "t12"]


@pytest.mark.parametrize("row", ROWS)
def test_every_row_has_a_test_with_its_number(row):
    tests = "".join(path.read_text() for path in Path(__file__).parent.glob("test_*.py"))
    assert re.search(rf"^def test_{row}_", tests, re.MULTILINE)
