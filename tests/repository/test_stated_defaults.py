"""Each default that a page or a help states as a number is that of the program."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from key_page import TABLES

import flexgen
from flexgen.base.spec.keys import REQUIRED, Kinds
from flexgen.cli.verb_tables.verbs import VERBS
from flexgen.codegen.emission.interface import STRUCTS
from flexgen.feedback.loop.hardware import DriveHardware
from flexgen.identification.load.payload import LOW_PASS_HZ
from flexgen.inversion.comparison import bdf, reduced
from flexgen.simulation.integration.hold import SAMPLE_TIME
from flexgen.studies.templates import payload_beam

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    *ROOT.glob("docs/*.md"),
    ROOT / "README.md",
    ROOT / "models" / "README.md",
    *ROOT.glob("flexgen/**/README.md"),
]
STATED = re.compile(
    r"(?:(?P<first>(?<![\w.])\d[-.\de]*) (?:s )?\(default\)|\b(?P<zero>0) by default|default:? "
    r"(?:accuracy is |is |tolerance |of )?(?P<after>\d[-+.\de]*+)(?!/| (?:of\b|%|to\b)))"
)


def stated(text: str) -> list[float]:
    """The numbers that a text gives as defaults, in its order."""
    matches = STATED.finditer(text)
    return [float((m["first"] or m["zero"] or m["after"]).rstrip(".-")) for m in matches]


def of_call(function: Callable[..., object], name: str) -> float:
    return float(inspect.signature(function).parameters[name].default)


def of_keys(table: str, name: str) -> float:
    """The default of a key, which is the same in all kinds of its table that have one."""
    form = TABLES[table]
    keys = (
        [k for own in form.kinds.values() for k in (*form.shared, *own.keys)]
        if isinstance(form, Kinds)
        else form.keys
    )
    (default,) = {key.default for key in keys if key.name == name and key.default is not REQUIRED}
    return float(default)


(OPTIONS,) = (struct for struct in STRUCTS if struct.name == "inversion_options")
# The defaults of the program in the order of the page.
TRUTHS = {
    "docs/c_library.md": [float(next(x.default for x in OPTIONS.fields if x.name == "growth"))],
    "docs/command_line.md": [of_call(flexgen.solve, "time_limit")],
    "docs/elastic_payload.md": [payload_beam.DAMPING],
    "docs/methods.md": [of_call(flexgen.solve, "accuracy"), of_call(flexgen.solve, "time_limit")],
    "flexgen/inversion/comparison/README.md": [bdf.stable_order([], 1e-3), reduced.RTOL],
    "models/README.md": [
        of_keys("`[[element.dof]]`", "damping"),
        of_keys("`gear`", "damping"),
        of_keys("`[[sensor]]`", "noise"),
        of_keys("`[[move]]`", "radius"),
        of_keys("`[[move]]`", "degree"),
    ],
}
DRIVE = DriveHardware()
HELPS = {
    ("solve", "sample_time"): SAMPLE_TIME,
    ("export fmu", "sample_time"): SAMPLE_TIME,
    ("export fmu", "version"): of_call(flexgen.export_fmu, "version"),
    ("excite", "sample_time"): DRIVE.sample_s,
    ("excite", "delay"): DRIVE.delay_s,
    ("excite", "encoder_noise"): DRIVE.encoder_noise_rad,
    ("excite", "encoder_resolution"): DRIVE.encoder_resolution_rad,
    ("excite", "torque_noise"): DRIVE.torque_noise_Nm,
    ("identify-load", "low_pass_hz"): LOW_PASS_HZ,
    ("kinematics", "rotation"): 0.0,
    **{
        ("tune", name): of_call(flexgen.tune_cascade, name)
        for name in (
            "evaluations",
            "sample_time",
            "delay",
            "encoder_noise",
            "gain_margin_db",
            "phase_margin_deg",
        )
    },
}


def test_defaults_on_the_pages_are_those_of_the_program():
    pages = {
        str(page.relative_to(ROOT)): stated(page.read_text(encoding="utf-8")) for page in PAGES
    }
    assert {name: found for name, found in pages.items() if found} == TRUTHS


def test_defaults_in_the_helps_are_those_of_the_program():
    options = {
        (verb.name, option.name): option.help
        for verb in VERBS.values()
        for option in verb.options()
    }
    assert {name: found for name, text in options.items() if (found := stated(text))} == {
        name: [value] for name, value in HELPS.items()
    }


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("(default 120, 0: no limit)", [120.0]),
        ("default: 1e-3; 5, 7 (default)", [1e-3, 7.0]),
        ("default: 0.7 of the lowest; 1 to 16", []),
    ],
)
def test_a_planted_default_is_found(text, found):
    assert stated(text) == found
