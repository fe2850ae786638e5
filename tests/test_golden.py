"""Values computed by hand for the code that both sides of the parity check share."""

import pytest

from tests.faults.golden import GOLDEN_CASES


@pytest.mark.parametrize("case", GOLDEN_CASES, ids=lambda case: case.__name__)
def test_a_golden_case_holds(case, tiny_bundle):
    case(tiny_bundle)
