"""Tableaus of collocation: tables of the literature, exact integrals of monomials, planted
errors.
"""

from __future__ import annotations

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose

from flexgen.base.numerics.tableaus import Tableau, gauss, lobatto, radau
from flexgen.codegen.emission.clib_files import read_clib


def test_known_tableaus_of_gauss_radau_and_lobatto() -> None:
    """Butcher tables from the literature, and the double integrals by exact integration of
    monomials.
    """
    two = gauss(2)
    r = np.sqrt(3) / 6
    assert (two.name, two.order) == ("Gauss 2", 4)
    assert_allclose(two.c, [0.5 - r, 0.5 + r], rtol=1e-14)
    assert_allclose(two.A, [[0.25, 0.25 - r], [0.25 + r, 0.25]], rtol=1e-13)
    three = radau(2)
    assert (three.name, three.order) == ("Radau IIA 2", 3)
    assert_allclose(three.A, [[5 / 12, -1 / 12], [3 / 4, 1 / 4]], rtol=1e-13)
    simpson = lobatto()
    assert (simpson.name, simpson.order) == ("Lobatto IIIA 3", 4)
    assert_allclose(
        simpson.A, [[0, 0, 0], [5 / 24, 1 / 3, -1 / 24], [1 / 6, 2 / 3, 1 / 6]], atol=1e-15
    )
    theta = np.array([0.0, 0.3, 0.8, 1.0])
    for table in (two, three, simpson, gauss(3)):
        once, twice = table.weights(theta)
        values = table.lagrange(theta)
        for k in range(len(table.c)):
            f = table.c**k
            assert_allclose(values @ f, theta**k, atol=1e-13)
            assert_allclose(once @ f, theta ** (k + 1) / (k + 1), atol=1e-13)
            assert_allclose(twice @ f, theta ** (k + 2) / (k + 1) / (k + 2), atol=1e-13)
            assert_allclose(table.AA @ f, table.c ** (k + 2) / (k + 1) / (k + 2), atol=1e-13)
            assert_allclose(
                [table.b @ f, table.bb @ f], [1 / (k + 1), 1 / (k + 1) / (k + 2)], rtol=1e-12
            )


@pytest.mark.parametrize(
    ("name", "allowed"), [("c", 3e-16), ("b", 3e-16), ("A", 1e-13), ("AA", 3e-16)]
)
def test_the_tables_in_c_are_those_of_three_gauss_points(name: str, allowed: float) -> None:
    """A wrong digit would be an error of the motion that no law shows; A[0][2] has one of 6e-14,
    less than rounding.
    """
    found = re.search(rf"gauss_{name}\b[^=;]*= (\{{[^;]*);", read_clib()["inversion_common.h"])
    assert found is not None
    numbers = [
        float(a) / float(b or 1) for a, b in re.findall(r"(-?\d\.\d+)(?: / (\d+\.\d+))?", found[1])
    ]
    assert_allclose(numbers, np.ravel(getattr(gauss(3), name)), rtol=0, atol=allowed)


@pytest.mark.parametrize(("which", "size"), [("b", 1e-9), ("A", 1e-4), ("order", 1)])
def test_a_tableau_that_breaks_an_order_condition_is_refused(which: str, size: float) -> None:
    good = gauss(2)
    parts = {name: getattr(good, name) for name in ("name", "c", "A", "b", "AA", "bb", "order")}
    Tableau(**parts)
    with pytest.raises(AssertionError, match=r"Gauss 2: (order condition|stage order)"):
        Tableau(**{**parts, which: parts[which] + size})
