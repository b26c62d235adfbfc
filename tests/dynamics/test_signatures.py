"""The table of functions: every function of `Equations` has a row, with the names and shapes that
it really has.
"""

from __future__ import annotations

import casadi as ca
import pytest

from flexgen.dynamics.mechanics.equations import BUILDERS, Equations, derive
from flexgen.dynamics.mechanics.signatures import (
    FLEXIBLE_JOINT,
    PORTS,
    PYTHON_PORTS,
    PYTHON_TABLE,
    TABLE,
    Row,
    offered_functions,
    split_product,
)

IN_C_ONLY = {"arm_forward_derivatives", "mass_matrix_packed"}  # emitted from others
ROWS = {row.name: row for row in (*TABLE, *PYTHON_TABLE) if row.name not in IN_C_ONLY}


def differences(equations: Equations, row: Row) -> list[str]:
    """Differences between a row of the table and the function: names and shapes."""
    model = equations.model
    function = equations.function(row.name)
    n_x = 2 * model.dof
    sizes = {key: getattr(model, key) for key in ("n_a", "n_g", "n_e", "n_m")}
    sizes |= {
        "n": model.dof,
        "n_x": n_x,
        "n_y": model.output.size,
        "n_t": model.output.target_size,
    }
    sizes["n_l"] = len(model.lines)
    sizes["n_s"] = sum(len(sensor.channels) for sensor in model.sensors)
    if row.name == "output" and model.output.type == "tool_pose":
        sizes["n_y"] = 3
    out = []
    for kind, names, real in (
        (
            "inputs",
            row.inputs.split(),
            [(function.name_in(i), function.size_in(i)) for i in range(function.n_in())],
        ),
        (
            "outputs",
            row.outputs.split(),
            [(function.name_out(i), function.size_out(i)) for i in range(function.n_out())],
        ),
    ):
        if not model.n_e:  # empty arrays are left out
            names = [
                name
                for name in names
                if "n_e" not in (PORTS | PYTHON_PORTS)[name][0] or name == "tau_e"
            ]
        if names != [name for name, _ in real]:
            out.append(f"{row.name}: {kind} {names}, in fact {[name for name, _ in real]}")
            continue
        for name, shape in real:
            extents = [*(PORTS | PYTHON_PORTS)[name][0], "1", "1"][:2]
            stated = tuple(shape[1] if x == "k" else int(eval(x, {}, sizes)) for x in extents)
            if stated != shape:
                out.append(f"{row.name}: {name} {stated}, in fact {shape}")
    return out


def test_every_function_has_one_row_and_stands_in_the_docstring() -> None:
    own = {name: row for name, row in ROWS.items() if not split_product(name)[1]}
    assert sorted(own) == sorted(BUILDERS) and len(TABLE) + len(PYTHON_TABLE) == len(ROWS) + len(
        IN_C_ONLY
    )
    for name, row in own.items():
        assert f"    {name}({', '.join(row.inputs.split())}) -> " in (Equations.__doc__ or "")


@pytest.mark.parametrize(
    "model", ["elbow", "planar5_nmp@coupled", "beam_arm", "manutec_r3_18", "kr300_efjm"]
)
def test_rows_have_the_names_and_shapes_of_the_functions(model: str) -> None:
    equations = derive(model)
    special = {*FLEXIBLE_JOINT, "rotor_coupling"}
    left_out = special - set(offered_functions(equations.model))
    rows = [row for name, row in ROWS.items() if split_product(name)[0] not in left_out]
    if model not in ("elbow", "planar5_nmp@coupled"):  # (the others' products take seconds)
        rows = [row for row in rows if not split_product(row.name)[1]]
    assert [text for row in rows for text in differences(equations, row)] == []


def test_wrong_rows_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: a wrong name, a wrong shape, a function without a row."""
    equations = derive("elbow")
    gravity = ROWS["gravity"]
    assert differences(equations, Row("gravity", "", "", "q_m", gravity.outputs))
    monkeypatch.setitem(PORTS, "g", (("n_a", "n_a"), "{tau}", ""))
    assert differences(equations, gravity) == ["gravity: g (2, 2), in fact (2, 1)"]
    monkeypatch.setitem(
        BUILDERS, "new", lambda system: ([ca.SX.sym("q_a")], ["q_a"], [ca.SX(1)], ["y"])
    )
    assert sorted(ROWS) != sorted(BUILDERS)
