"""The packed mass matrix: one triangle of the full one; only where it is named."""

from __future__ import annotations

import numpy as np
import pytest
from toolchain import needs_compiler

import flexgen
from flexgen.codegen.emission.spec import choose_functions

NAMES = ("mass_matrix", "mass_matrix_packed")


@needs_compiler
@pytest.mark.parametrize(
    ("name", "parameters"), [("planar5_nmp", ()), ("elbow", ("payload",)), ("manutec_r3", ())]
)
def test_it_is_the_lower_triangle_by_columns(name, parameters, tmp_path):
    model = flexgen.read(name)
    made = flexgen.generate(model, tmp_path, functions=NAMES, parameters=parameters)
    library = flexgen.load(made.directory)
    n = model.n_a
    assert library.sizes["n_packed"] == n * (n + 1) // 2
    q = np.random.default_rng(0).normal(size=(37, n))
    full = library.mass_matrix(q)
    packed = library.mass_matrix_packed(q)
    rows, columns = np.triu_indices(n)[::-1]  # by columns: (0, 0), (1, 0), ..., (1, 1), ...
    assert np.allclose(packed, full[:, rows, columns], rtol=1e-13, atol=1e-13 * np.abs(full).max())
    assert np.array_equal(library.mass_matrix_packed(q[5]), packed[5])
    text = (made.directory / f"{name}.h").read_text()
    assert (
        f"#define {name.upper()}_NPACKED {n * (n + 1) // 2}" in text and "lower triangle" in text
    )


def test_it_is_left_out_where_it_is_not_asked_for():
    model = flexgen.read("elbow")
    assert "mass_matrix_packed" not in choose_functions(None, model)
    assert choose_functions(NAMES[::-1], model) == NAMES
