"""Products and determinants of polynomials."""

import kvision as K
from composition_tests import Case
from view_tests import ViewTests

G = K.geometry


class TestPolynomials(ViewTests):
    cases = {
        "determinant": Case(G.determinant_to_polynomial, ((2, 3, 13),)),
    }  # fmt: skip
    compiled = ()
