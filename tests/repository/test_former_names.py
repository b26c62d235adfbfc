"""Former names of arguments work with a warning in the line of the caller; functions have few
parameters.
"""

from __future__ import annotations

import inspect
import json
from pathlib import Path
from typing import Any

import pytest

import flexgen
from flexgen.base.calls.deprecation import renamed
from flexgen.base.errors import ArgumentError
from flexgen.cli.verb_tables.verbs import VERBS

MOST = 8  # parameters of a function; more of them belong into an object of options

# Keyword-only parameters of a public verb that are options of the command line do not count: each
# is a row of `flexgen.cli.verb_tables.verbs`, with its help, and scripts of version 0.2 have them
# by name. Functions with more than that; each number may only fall:
LARGER = {
    # what is free, its bounds and priors by name; how the errors of the responses are modelled
    "identify": 10,
    # what drives the robot: a trajectory or a command, its hold, feedback, a start; what it
    # touches
    "simulate": 10,
}
# Verbs that call another function where their input is of another kind: their options are its
# parameters as well.
OTHERS = {
    "tune": "tune_cascade",  # a model, not a benchmark
    "identify": "fit_motion",  # with segments
}


def larger(functions: dict[str, Any]) -> dict[str, int]:
    """Functions with more than `MOST` parameters outside of the command line, and how many they
    have.
    """
    counts = {}
    for name, what in functions.items():
        options = {
            o.parameter
            for verb in VERBS.values()
            if name in (verb.function, OTHERS.get(verb.name))
            for o in verb.options()
        }
        parameters = inspect.signature(what).parameters.values()
        counts[name] = sum(
            not (p.kind is p.KEYWORD_ONLY and p.name in options) for p in parameters
        )
    return {name: count for name, count in counts.items() if count > MOST}


def test_no_further_public_function_has_more_than_eight_parameters():
    public = {
        name: getattr(flexgen, name)
        for name in flexgen.__all__
        if inspect.isfunction(getattr(flexgen, name))
    }
    found = larger(public)
    assert found.keys() == LARGER.keys() and all(found[name] <= LARGER[name] for name in found)


def test_a_planted_function_with_nine_parameters_is_seen():
    assert larger({"f": lambda a, b, c, d, e, f, g, h, i: None, "g": lambda a: None}) == {"f": 9}


def test_generate_takes_its_former_first_argument_with_a_warning(tmp_path):
    with pytest.warns(
        DeprecationWarning, match="given model_or_equations=, expected its new name, model="
    ) as caught:
        made = flexgen.generate(model_or_equations="elbow", directory=tmp_path / "e", build=False)
    assert made.directory == tmp_path / "e"
    assert [Path(warning.filename).name for warning in caught] == [Path(__file__).name]


def test_both_names_of_an_argument_are_refused():
    call = renamed(old="new")(lambda new=0: new)
    with pytest.raises(TypeError, match="unexpected keyword argument 'old'"):
        call(new=1, old=2)


def test_limits_from_a_model_are_those_of_its_file_or_those_given():
    limits = flexgen.Limits.from_model("four_mass")
    assert limits == flexgen.Limits.from_model(flexgen.derive("four_mass")) and limits.torque == (
        20.0,
    )
    assert flexgen.Limits.from_model("elbow", torque=20.0, speed=[100.0, 200.0]) == flexgen.Limits(
        (20.0, 20.0), (100.0, 200.0)
    )
    with pytest.raises(ArgumentError, match="states none"):
        flexgen.Limits.from_model("planar5_mp")


def test_results_of_exports_work_as_in_version_0_2_with_a_warning(tmp_path):
    """A path of MuJoCo, a pair of URDF, the attributes of an FMU, the name of a folder."""
    mujoco = flexgen.export_mujoco("elbow", tmp_path / "elbow.xml")
    assert Path(mujoco).read_text() == mujoco.path.read_text() and f"{mujoco}" == str(
        tmp_path / "elbow.xml"
    )
    for old, expected in ((lambda: mujoco.name, "elbow.xml"), (lambda: mujoco.suffix, ".xml")):
        with pytest.warns(
            DeprecationWarning,
            match=r"export_mujoco: given \.\w+, expected its new place, \.path\.",
        ):
            assert old() == expected
    urdf = flexgen.export_urdf("elbow", tmp_path / "arm.urdf")
    with pytest.warns(
        DeprecationWarning, match="given a pair of paths, expected .files"
    ) as caught:
        path, overlay = urdf
    assert (path, overlay) == urdf.files and overlay == urdf.details["overlay"]
    assert {Path(warning.filename).name for warning in caught} == {Path(__file__).name}
    fmu = flexgen.export_fmu("elbow", tmp_path / "elbow.fmu", binary=False)
    with pytest.warns(
        DeprecationWarning, match=r"given .token, expected its new place, .details\['token'\]"
    ):
        assert fmu.token == fmu.details["token"]
    folder = flexgen.export_mex("elbow@payload", tmp_path / "mex")
    with pytest.warns(DeprecationWarning, match="given .name"):
        assert (
            folder.name == "elbow_payload" and folder.directory == folder.path == tmp_path / "mex"
        )
    with pytest.warns(DeprecationWarning, match="given a former name, expected flexgen.Exported"):
        assert flexgen.ExportedFmu is flexgen.Exported
    for call in (lambda: folder.kinds, lambda: mujoco.kinds):
        with pytest.raises(AttributeError, match="kinds"):
            call()
    with pytest.raises(TypeError, match="not a sequence"):
        list(folder)


def test_an_export_says_what_a_user_must_know_and_is_written_as_json(tmp_path):
    exact = flexgen.export_mujoco("elbow", tmp_path / "elbow.xml")
    viscous = flexgen.export_mujoco("manutec_r3", tmp_path / "arm.xml", friction="viscous")
    assert (
        exact.notes == ()
        and "all friction but viscous is left out" in viscous.summary().splitlines()[-1]
    )
    data = json.loads(viscous.save(tmp_path / "arm.json").read_text())
    assert (
        data["kind"] == "mujoco"
        and data["friction"] == "viscous"
        and data["files"] == [str(tmp_path / "arm.xml")]
    )
