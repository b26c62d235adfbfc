"""The table ``[uncertainty]``: wrong ones are refused, an identification writes one, draws have
its distribution.
"""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bristled import bristled, tables
from hysteretic import BENT, with_elements

import flexgen
from flexgen.dynamics.mechanics.parameters import select
from flexgen.identification.responses.parameters import ParameterVector
from flexgen.identification.responses.result import Estimated, FitStatus
from flexgen.studies.tolerances.in_loop import draw_plants
from flexgen.studies.tolerances.model_file import with_uncertainty
from flexgen.studies.tolerances.sources import of_equations, sources_of

PAIR = {"parameters": ["q1.stiffness", "q2.stiffness"], "sd": [0.1, 0.2]}


def elbow(**table):
    return flexgen.read("elbow", overrides={"uncertainty": table})


@pytest.mark.parametrize(
    ("table", "expected"),
    [
        ({"common": ["lengths"]}, "some of stiffness, damping, friction, masses, motor_inertia"),
        ({"stiffness": -0.1}, ">= 0"),
        ({"stiffnes": 0.1}, "stiffness"),
        ({"parameters": ["q1.stiffness"]}, "for each of the parameters"),
        (PAIR | {"correlation": [1.0, 0.3, 0.2, 1.0]}, "symmetric matrix"),
        (PAIR | {"correlation": [2.0, 0.3, 0.3, 1.0]}, "symmetric matrix"),
        (PAIR | {"correlation": [1.0, 0.3]}, "4 numbers"),
        (PAIR | {"correlation": [1.0, 1.5, 1.5, 1.0]}, "the eigenvalue -0.5"),
        ({"parameters": ["q1.stifness"], "sd": [0.1]}, "such as q1.stiffness, q2.stiffness"),
        ({"parameters": ["stiffness"], "sd": [0.1]}, "names of single numbers"),
    ],
)
def test_wrong_tables_are_refused(table, expected):
    with pytest.raises(flexgen.ModelError, match="uncertainty") as caught:
        elbow(**table)
    assert expected in str(caught.value)


def test_a_wrong_name_is_found_with_its_file_and_line(tmp_path):
    text = (Path(flexgen.__file__).parent / "model/shipped/elbow.toml").read_text()
    lines = [
        *text.splitlines(),
        "[uncertainty]",
        "sd = [0.1]",
        'parameters = ["q9.stiffness"]',
        "",
    ]
    file = tmp_path / "elbow.toml"
    file.write_text("\n".join(lines))
    with pytest.raises(
        flexgen.ModelError, match=r"uncertainty\.parameters.*q9\.stiffness.*such as q"
    ) as caught:
        flexgen.read(file)
    assert f"elbow.toml:{len(lines) - 1}:" in str(caught.value)


def test_a_table_without_deviations_is_refused():
    model = elbow()
    with pytest.raises(flexgen.ArgumentError, match="standard deviations of no number"):
        sources_of(model, model.uncertainty)


def test_predict_refuses_a_model_without_table_and_solutions_of_a_baseline():
    with pytest.raises(flexgen.ArgumentError, match=r"no table \[uncertainty\]"):
        flexgen.predict("elbow")
    rigid = flexgen.solve(elbow(stiffness=0.1), method="rigid", verify=False, progress=False)
    with pytest.raises(flexgen.ArgumentError, match="status baseline"):
        flexgen.predict(rigid.model, solution=rigid)
    with pytest.raises(flexgen.ArgumentError, match="at least 16"):
        flexgen.predict(elbow(stiffness=0.1), robots=3)


def test_the_table_changes_nothing_else():
    """Neither the canonical text of a model, by which libraries are kept, nor its torques."""
    plain = flexgen.read("elbow")
    with_table = elbow(stiffness=0.1)
    assert plain.text == with_table.text
    torques = [flexgen.solve(m, progress=False).trajectory["tau_m"] for m in (plain, with_table)]
    assert np.array_equal(*torques)


def test_draws_have_the_moments_of_the_table():
    model = elbow(
        **PAIR,
        correlation=[1.0, -0.6, -0.6, 1.0],
        masses=0.03,
        common=["masses"],
        motor_inertia=0.5,
        payload=2.0,
    )
    sources = sources_of(model, model.uncertainty)
    x = sources.errors(np.random.default_rng(1).standard_normal((20000, sources.root.shape[1])))
    k = {name: i for i, name in enumerate(sources.names)}
    pair = x[:, [k["q1.stiffness"], k["q2.stiffness"]]]
    assert np.allclose(np.cov(pair.T), [[0.01, -0.012], [-0.012, 0.04]], rtol=0.05)
    assert np.array_equal(x[:, k["upper.mass"]], x[:, k["fore.mass"]])
    rotor = 1.0 + x[:, k["m1.inertia"]]  # log-normal
    assert rotor.min() > 0.0 and abs(np.median(rotor) - 1.0) < 0.02
    assert abs(rotor.std() / rotor.mean() - 0.5) < 0.02
    load = x[:, k["payload.mass"]]
    assert load.min() == -model.payload.mass  # none left; half of the robots would have less
    assert abs(np.quantile(load, 0.975) - 1.96 * 2.0) < 0.1


EVERY = {
    "stiffness": 0.1,
    "masses": 0.05,
    "friction": 0.3,
    "motor_inertia": 0.02,
    "payload": 1.0,
    "delay": 1e-3,
    "common": ["masses", "friction"],
    "parameters": ["q2.stiffness", "m1.viscous", "q1.damping"],
    "sd": [0.4, 0.0, 0.2],
    "correlation": [1.0, 0.2, -0.5, 0.2, 1.0, 0.1, -0.5, 0.1, 1.0],
}


def test_sources_have_the_deviations_and_correlations_of_the_table():
    """Common errors are one column; numbers that are named belong to no group; roots give the
    correlation back.
    """
    model = elbow(**EVERY)
    found = sources_of(model, model.uncertainty)
    assert dict(zip(found.names, found.sd.tolist(), strict=True)) == {
        "q1.stiffness": 0.1,
        "upper.mass": 0.05,
        "fore.mass": 0.05,
        "m1.inertia": 0.02,
        "m2.inertia": 0.02,
        "payload.mass": 1.0,
        "delay": 1e-3,
        "q2.stiffness": 0.4,
        "q1.damping": 0.2,
    }
    order = ["stiffness", "masses", "motor_inertia", "payload", "delay", "parameters"]
    assert list(dict.fromkeys(found.kinds)) == order
    C = np.eye(9)
    for a, b, value in (("upper.mass", "fore.mass", 1.0), ("q2.stiffness", "q1.damping", -0.5)):
        pair = [found.names.index(a), found.names.index(b)]
        C[np.ix_(pair, pair)] = [[1.0, value], [value, 1.0]]
    assert found.root @ found.root.T == pytest.approx(C, abs=1e-12)
    owners = {p.name: found.names[i] for p, i in zip(found.parameters, found.owner, strict=True)}
    assert owners["upper.inertia_yy"] == "upper.mass" and owners["payload.mass"] == "payload.mass"
    assert "upper.com_x" not in owners and "delay" not in owners


def test_numbers_of_robots_follow_from_the_errors_of_their_sources():
    """A relative error multiplies, a mass is added, a delay changes no number; directions are
    differences.
    """
    model = elbow(**EVERY)
    found = sources_of(model, model.uncertainty)
    errors = 0.1 * np.random.default_rng(1).standard_normal((2, len(found.names)))
    values = found.values(errors)
    for k, (parameter, i) in enumerate(zip(found.parameters, found.owner, strict=True)):
        expected = parameter.value * (1 + errors[:, i])
        if parameter.name == "payload.mass":
            expected = parameter.value + errors[:, i]
        assert values[:, k] == pytest.approx(expected, rel=1e-12)
    step = 1e-3 * np.eye(len(found.names))
    differences = (found.values(step) - found.values(-step)).T / 2e-3
    assert found.directions == pytest.approx(differences, rel=1e-9, abs=1e-12)
    assert dict(zip(found.names, found.added, strict=True))["delay"]
    springs = {n for n, spring in zip(found.names, found.springs, strict=True) if spring}
    assert springs == {"q1.stiffness", "q2.stiffness"}


def test_no_robot_has_less_than_no_stiffness_or_no_load():
    model = elbow(stiffness=0.1, payload=1.5, delay=1e-3)
    found = sources_of(model, model.uncertainty)
    lowest = found.errors(np.full((1, found.root.shape[1]), -30.0))[0]
    given = dict(zip(found.names, lowest, strict=True))
    assert given["q1.stiffness"] == -1.0 and given["payload.mass"] == -model.payload.mass
    assert given["delay"] == pytest.approx(-0.03)


def test_states_are_sources_that_equations_without_states_lack():
    """Lost motion and levels of bristles; where nothing is left, no source changes a number."""
    lossy = with_elements("elbow", BENT, uncertainty={"lost_motion": 0.3})
    found = sources_of(lossy, lossy.uncertainty)
    assert found.names == ("q1.lost_motion", "q2.lost_motion")
    of_q1 = [p for p, i in zip(found.parameters, found.owner, strict=True) if i == 0]
    assert len(of_q1) == len(BENT) and all("lost_motion" in p.name for p in of_q1)
    none = of_equations(found, lossy)
    assert [p.name for p in none.parameters] == ["payload.mass"]
    assert none.values(np.ones((1, 2))).tolist() == [[lossy.payload.mass]]
    both = with_elements("elbow", BENT, uncertainty={"lost_motion": 0.3, "stiffness": 0.1})
    found = sources_of(both, both.uncertainty)
    kept = of_equations(found, both)
    assert {p.name for p in kept.parameters} == {"q1.stiffness", "q2.stiffness"}
    assert [found.names[i] for i in kept.owner] == [p.name for p in kept.parameters]
    model = bristled("elbow", tables("elbow"), uncertainty={"friction": 0.2})
    found = sources_of(model, model.uncertainty)
    levels = [p.name for p, i in zip(found.parameters, found.owner, strict=True) if i == 0]
    assert found.names[0].endswith(".lugre") and found.kinds[0] == "friction"
    assert {name.partition("_")[2] for name in levels} == {"coulomb", "static"}


def test_bodies_without_mass_have_no_source():
    model = elbow(masses=0.05)
    hollow = replace(model.elements[0], body=replace(model.elements[0].body, mass=0.0))
    assert sources_of(model, model.uncertainty).names == ("upper.mass", "fore.mass")
    model = replace(model, elements=(hollow, *model.elements[1:]))
    assert sources_of(model, model.uncertainty).names == ("fore.mass",)


@pytest.mark.parametrize(("excess", "refused"), [(1e-10, False), (1e-8, True), (0.25, True)])
def test_a_correlation_that_no_numbers_have_is_refused(excess, refused):
    """Given in Python; rounding is forgiven."""
    model = elbow(**PAIR, correlation=[1.0, 0.0, 0.0, 1.0])
    x = 1.0 + excess
    given = replace(model.uncertainty, correlation=(1.0, x, x, 1.0))
    if refused:
        with pytest.raises(flexgen.ArgumentError, match=f"the eigenvalue -{excess:.3g}, expected"):
            sources_of(model, given)
        return
    found = sources_of(model, given)
    assert found.root @ found.root.T == pytest.approx(np.ones((2, 2)), rel=1e-8)


def test_plants_for_the_loop_are_the_same_robots():
    model = elbow(stiffness=0.1, payload=0.5)
    plants = draw_plants(model, 3, seed=5)
    sources = sources_of(model, model.uncertainty)
    errors = sources.errors(np.random.default_rng(5).standard_normal((3, sources.root.shape[1])))
    values = sources.values(errors)
    for robot, row in zip(plants.values(), values, strict=True):
        for parameter, value in zip(sources.parameters, row, strict=True):
            found = (
                parameter.value + robot["payload"] if parameter.name == "payload.mass" else None
            )
            found = parameter.value * robot[parameter.name] if found is None else found
            assert abs(found - value) <= 1e-12 * abs(value)


def test_an_identification_writes_deviations_relative_to_the_values():
    model = flexgen.read("elbow")
    vector = ParameterVector(
        model,
        ["q1.stiffness", "q2.stiffness", "fore.com_x"],
        ties={"q2.damping": "q2.stiffness"},
        start={"fore.com_x": -0.2},
    )
    values = dict(zip(vector.names, range(3), strict=True))
    x = vector.start
    root = np.array([[0.02, 0.0, 0.0], [0.01, 0.6, 0.0], [0.001, 0.0, 0.004]])
    names, covariance = Estimated(vector, x, root @ root.T, FitStatus.FITTED)._relative_covariance(
        root @ root.T
    )
    old = 'name = "x"\n\n[uncertainty]\nmasses = 0.03\nsd = [1.0]\nparameters = ["a"]\n\n[tool]\n'
    # again: one table
    text = with_uncertainty(with_uncertainty(old, names, covariance), names, covariance)
    parsed = tomllib.loads(text)
    found = parsed["uncertainty"]
    names = found["parameters"]
    assert (
        parsed["tool"] == {}
        and found["masses"] == 0.03
        and set(values) < set(names)
        and "q2.damping" in names
    )
    sd = dict(zip(names, found["sd"], strict=True))
    n = len(names)
    correlation = np.array(found["correlation"]).reshape(n, n)
    assert sd["q1.stiffness"] == pytest.approx(0.02) and sd["q2.damping"] == pytest.approx(
        np.hypot(0.01, 0.6), rel=1e-5
    )
    assert sd["fore.com_x"] == pytest.approx(np.hypot(0.001, 0.004) / 0.2, rel=1e-5)
    at = names.index
    assert correlation[at("q2.stiffness"), at("q2.damping")] == pytest.approx(1.0)
    # a center of mass that is negative: a larger number is a smaller relative error
    assert correlation[at("q1.stiffness"), at("fore.com_x")] == pytest.approx(
        -0.001 / np.hypot(0.001, 0.004), rel=1e-6
    )
    assert {p.name for p in select(model, names)} == set(names)


def test_the_header_states_the_deviations(tmp_path):
    """Also where the folder has the library of the same robot without a table."""
    flexgen.generate("elbow", tmp_path, functions=["gravity"])
    assert "Standard deviations" not in (tmp_path / "elbow.h").read_text()
    table = {"parameters": ["q2.stiffness"], "sd": [0.004]}
    flexgen.generate(elbow(damping=0.3, payload=0.5, **table), tmp_path, functions=["gravity"])
    comment = " ".join((tmp_path / "elbow.h").read_text().replace("\n *", "").split())
    assert "damping 30 %, payload 0.5 kg, q2.stiffness 0.4 %." in comment
    with pytest.raises(flexgen.FlexgenError, match=r'given "q2 \*/"'):
        flexgen.generate(elbow(parameters=["q2 */"], sd=[0.1]), tmp_path, functions=["gravity"])
