"""Every operator is tested by an inherited suite."""

import pytest

import suites
from kvision import _ops
from op_tests import OpTests
from point_op_tests import PointOpTests

pytestmark = pytest.mark.interface


def test_a_suite_claims_every_operator():
    suites.load()
    claimed = {n for suite in (OpTests, PointOpTests) for cls in suites.subclasses(suite) for n in cls.operators}
    registered = {
        n
        for n, o in _ops.operators.items()
        if o.definition.__module__.startswith("kvision.") and not n.endswith("_list")  # of lists: tests of their own
    }
    assert sorted(registered - claimed) == [], "operators of no suite"
    assert sorted(claimed - set(_ops.operators)) == [], "suites of operators that do not exist"
