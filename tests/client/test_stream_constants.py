"""Constants of the inversion header: recommended options of a stream, its memory, the operations
of an update.
"""

from __future__ import annotations

import dataclasses
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from bristled import bristled
from counted import counting_program
from emitted import _folder, run
from harmonic import harmonic
from hysteretic import BENT, SLIPS, with_elements
from toolchain import CC, needs_compiler, tool

from flexgen.analysis.analyze import analyze
from flexgen.analysis.zero_dynamics.zeros import preview
from flexgen.codegen.build.generate import GeneratedLibrary, generate
from flexgen.codegen.build.stream_defaults import stream_defaults
from flexgen.codegen.emission.spec import LibrarySpec, library_spec
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.signatures import INVERSION
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.inversion.problem.sampling import samples
from flexgen.paths.path import Path
from flexgen.runtime import load

pytestmark = needs_compiler

SPARE = 1.15  # of the memory, and some numbers: what the macro may ask for beyond what is needed
NUMBERS = 2500
TORQUE = (
    # of the largest: motions of stream and whole path agree better, their second derivatives by
    # differences not
    1e-3
)
GRID = [(1, 1), (1, 7), (2, 3), (10, 5), (11, 6), (37, 1), (100, 20), (513, 2), (10_000, 1_000)]


BRISTLED = "bristled_elbow"
HYSTERETIC = "hysteretic_elbow"
CURVED = "curved_elbow"
LIMITED = "limited_planar"  # with the part "limits"
HARMONIC = "harmonic_elbow"  # with it too
COUPLED = "coupled_planar"  # complete motor coupling


@cache
def equations(name: str) -> Equations:
    if name == BRISTLED:
        return derive(
            replace(bristled("elbow", {"m1": {"coulomb": 0.5, "stiffness": 800.0}}), name=BRISTLED)
        )
    if name == HYSTERETIC:
        return derive(replace(with_elements("elbow", SLIPS), name=HYSTERETIC))
    if name == CURVED:
        return derive(replace(with_elements("elbow", BENT), name=CURVED))
    if name == HARMONIC:
        return derive(replace(harmonic("elbow"), name=HARMONIC))
    if name == COUPLED:
        return derive(replace(derive("planar5_nmp@coupled").model, name=COUPLED, variant=""))
    if name == LIMITED:
        return derive(replace(derive("planar5_nmp").model, name=LIMITED))
    return derive(name)


@cache
def spec(name: str) -> LibrarySpec:
    functions = [f for f in INVERSION if f != "inversion_jacobians" or equations(name).model.n_e]
    functions += ["motor_harmonics"] * (name == HARMONIC) + ["rotor_coupling"] * (name == COUPLED)
    return library_spec(equations(name), functions)


@cache
def library(name: str, precision: str = "double") -> GeneratedLibrary:
    """The library of what inverts a model, in one file."""
    functions = [f.name for f in spec(name).functions]
    folder = _folder() / f"{name}_stream_{precision}"
    parts = ["limits"] * (name in (LIMITED, HARMONIC))
    return generate(
        equations(name).model,
        folder,
        functions=functions,
        amalgamate=True,
        precision=precision,
        parts=parts,
    )


def printed(
    name: str,
    body: str,
    tmp_path,
    compiler: str = CC,
    language: str = "-std=c99",
    precision: str = "double",
) -> list[list[int]]:
    """The numbers that a program prints, line by line; ``@`` is replaced by the name in capitals,
    ``$`` by the name.
    """
    text = (
        f'#include "{name}.h"\n#include <stdio.h>\n\nint main(void)\n{{\n{body}    return 0;\n}}\n'
    )
    file = tmp_path / ("main.cpp" if "++" in language else "main.c")
    file.write_text(text.replace("@", name.upper()).replace("$", name))
    folder = library(name, precision).directory
    words = [
        compiler,
        language,
        "-Wall",
        "-Wextra",
        "-Werror",
        f"-I{folder}",
        file,
        folder / f"lib{name}.a",
    ]
    run(*words, "-lm", "-o", "program", folder=tmp_path)
    return [
        [int(word) for word in line.split()]
        for line in run(tmp_path / "program", folder=tmp_path).splitlines()
    ]


@pytest.mark.parametrize("name", ["planar5_nmp", "planar5_mp", "beam_arm", "elbow"])
def test_the_slowest_unstable_zero_is_that_of_the_linear_model(name):
    """Two ways: the restricted Jacobians of the unactuated rows here, Lagrange's equations
    linearized there.
    """
    found = stream_defaults(equations(name).model, spec(name))
    tau = analyze(name).to_dict()["unstable_time_constant_s"]
    assert found is not None
    assert found.slowest_unstable_zero == pytest.approx(1.0 / tau if tau else 0.0, rel=1e-9)
    assert (
        found.look_ahead >= preview(tau) - 1e-12
        and found.look_ahead == found.intervals * found.period
    )


def test_no_recommendation_at_a_singular_pose():
    """The extended arm without gravity: its joints cannot move the output along the arm."""
    robot = dataclasses.replace(
        equations("planar5_nmp").model, home=(0.0, 0.0), gravity=(0.0, 0.0, 0.0)
    )
    made = library_spec(derive(robot), [f.name for f in spec("planar5_nmp").functions])
    assert stream_defaults(robot, made) is None


@pytest.mark.parametrize(
    ("name", "precision"),
    [
        ("elbow", "double"),
        (BRISTLED, "double"),
        (HYSTERETIC, "double"),
        (CURVED, "double"),
        (HARMONIC, "double"),
        (LIMITED, "double"),
        (LIMITED, "single"),
        ("planar5_nmp", "double"),
        (COUPLED, "double"),
        ("beam_arm", "double"),
        ("planar5_nmp", "single"),
    ],
)
def test_the_stated_memory_is_sufficient_and_at_most_slightly_too_large(name, precision, tmp_path):
    lines = "".join(
        f"    {{\n        const $_stream_options o = {{{n}, {s}, 0.005, 1e-6, {hold}}};\n"
        f'        printf("%lld %lld\\n", (long long)$_stream_work(&o), (long '
        f"long)@_STREAM_SIZE({n}, {s}));\n"
        f"    }}\n"
        for n, s in GRID
        for hold in ("@_HOLD_SPLINE, 0.0", "@_HOLD_ZOH, @_HOLD_DELAY_MAX")
    )
    for needed, macro in printed(name, lines, tmp_path, precision=precision):
        assert 0 < needed <= macro <= SPARE * needed + NUMBERS


@pytest.mark.parametrize("language", ["-std=c99", "-std=c++11"])
def test_the_constants_are_constant_expressions(language, tmp_path):
    body = (
        "    static $_real memory[@_STREAM_SIZE(@_STREAM_INTERVALS, "
        "@_STREAM_SAMPLES_PER_INTERVAL)];\n"
        "    const $_stream_options o = {@_STREAM_INTERVALS, @_STREAM_SAMPLES_PER_INTERVAL, "
        "@_STREAM_PERIOD, "
        "@_STREAM_TOLERANCE, @_HOLD_SPLINE, 0.0};\n"
        "    memory[0] = @_LOOK_AHEAD + @_SLOWEST_UNSTABLE_ZERO + $_home_q_a[0];\n"
        '    printf("%d\\n", memory[0] > 0.0 && $_stream_work(&o) <= (int64_t)(sizeof memory / '
        "sizeof memory[0]));\n"
    )
    compiler = CC if language == "-std=c99" else tool("g++")
    assert printed("planar5_nmp", body, tmp_path, compiler, language) == [[1]]


@pytest.mark.parametrize(
    "name",
    [
        "elbow",
        *(
            pytest.param(x, marks=pytest.mark.slow)
            for x in ("planar5_nmp", LIMITED, HARMONIC, BRISTLED, COUPLED)
        ),
    ],
)
def test_no_update_needs_more_operations_than_the_bound(name, tmp_path):
    """Counted by a number type of C++: short and long horizons, with limits that modify the
    path.
    """
    work = counting_program(library(name).directory, name, tmp_path)
    flags = ["-std=c++17", "-O1", f"-D{name.upper()}_NO_VECTORS", "-Wno-class-memaccess"]
    run(tool("g++"), *flags, f"{name}.cpp", "main.cpp", "-o", "count", folder=work)
    limited = False
    for n, s in ((4, 2), (10, 5), (24, 1), (40, 5)):
        status, counted, bound, active = map(int, run(work / "count", n, s, folder=work).split())
        assert counted > 1000 and status >= -14
        assert counted <= bound <= 300 * counted, (n, s)
        limited = limited or active == 1
    assert limited


@pytest.mark.parametrize("name", ["planar5_nmp", "beam_arm"])
def test_a_stream_with_the_recommended_options_follows_the_path(name):
    """Every update converges, and the torques are those of the whole path."""
    d = stream_defaults(equations(name).model, spec(name))
    assert d is not None
    made = load(library(name).directory)
    path = Path(equations(name), equations(name).model.move(None))
    reduction = Reduction(equations(name))
    fine = d.period / d.samples_per_interval
    intervals = int(np.ceil(path.duration / d.period))
    y, dy, ddy = samples(reduction, path, d.period, intervals + 2 * d.intervals)
    options = {
        "intervals": d.intervals,
        "samples_per_interval": d.samples_per_interval,
        "tolerance": d.tolerance,
    }
    stream = made.stream(y[0], path.q_start, period=d.period, **options)
    updates = [stream.update(*sample) for sample in zip(y[1:], dy[1:], ddy[1:], strict=True)]
    assert all(update.converged for update in updates)
    tau = np.vstack([update.tau_m for update in updates])
    n = intervals * d.samples_per_interval + 1
    before = (d.intervals - 1) * d.samples_per_interval
    whole = made.invert(
        *samples(reduction, path, fine, n),
        period=fine,
        q_start=path.q_start,
        n_pre=before,
        n_post=before,
        samples_per_interval=d.samples_per_interval,
    )
    assert np.abs(tau[:n] - whole.tau_m[:n]).max() <= TORQUE * np.abs(whole.tau_m).max()
