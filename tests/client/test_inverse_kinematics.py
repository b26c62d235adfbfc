"""Inverse kinematics in the emitted C: strict, the same bits everywhere, none lost, and every
misuse has a status.
"""

from __future__ import annotations

import pickle
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from emitted import _folder, run
from hostile_client import SANITIZE, can_sanitize
from toolchain import CC, STRICT, STRICT_CPP, needs_compiler, tool

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.codegen.build.compiler import find_compiler
from flexgen.codegen.emission import kinematics_header
from flexgen.runtime import processor
from flexgen.runtime.library import Library

pytestmark = needs_compiler
POINT = ("forward_kinematics", "jacobian")
ROBOTS = Path(__file__).resolve().parents[1] / "support" / "robots"
JOINTS = np.array([0.3, -1.1, 1.0, 0.4, 0.8, -0.2])

CLIENT = r"""
#include "manutec_r3_inverse_kinematics.h"
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#define ASK(q_min, starts, most, size) \
    manutec_r3_inverse_kinematics(p, R, q, q_min, starts, most, found, &count, work, size)
#define ALL(most) ASK(NULL, MANUTEC_R3_STARTS, most, size)

int main(void)
{
    const int64_t size = manutec_r3_inverse_kinematics_work();
    const int twice[6] = {0, 1, 2, 3, 4, 4}, outside[6] = {0, 1, 2, 3, 4, 6};
    double *work = malloc((size_t)size * sizeof(double)), p[3], R[9], found[16 * MANUTEC_R3_NA];
    double q[MANUTEC_R3_NA] = {0.3, -1.1, 1.0, 0.4, 0.8, -0.2};
    int count;
    if (work == NULL || manutec_r3_forward_kinematics(q, p, R) != MANUTEC_R3_OK) {
        return 1;
    }
    printf("%d", ALL(16));
    printf(" %d\n", count);
    for (int i = 0; i < count * MANUTEC_R3_NA; ++i) {
        printf("%a\n", found[i]);
    }
    printf("%d", ALL(0));
    printf(" %d", ALL(17));
    printf(" %d", manutec_r3_inverse_kinematics(p, R, q, twice, 9, 1, found, &count, work, size));
    printf(" %d", ASK(outside, 9, 1, size));
    printf(" %d", manutec_r3_inverse_kinematics(p, R, q, NULL, 0, 1, found, &count, work, size));
    printf(" %d", ASK(NULL, 9, 1, size - 1));
    printf(" %d", manutec_r3_inverse_kinematics(p, R, q, NULL, 9, 1, NULL, &count, work, size));
    printf(" %d", manutec_r3_inverse_kinematics(p, R, q, NULL, 9, 1, found, &count, NULL, size));
    R[4] *= 1.001;
    printf(" %d", ALL(16));
    R[4] = (double)NAN;
    printf(" %d %d", ALL(16), count);
    free(work);
    return 0;
}
"""


@cache
def library(name: str, isa: str = "native") -> Library:
    given = ROBOTS / f"{name}.toml"
    folder = _folder() / f"{name}_{isa}"
    return flexgen.load(
        flexgen.generate(
            given if given.exists() else name, folder, functions=POINT, isa=isa
        ).directory
    )


def pose(lib: Library, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    found = lib.forward_kinematics(q)
    return np.asarray(found.p), np.asarray(found.R)


def test_a_client_in_c_gets_the_bits_of_python_and_a_status_for_every_misuse(tmp_path):
    lib = library("manutec_r3")
    (tmp_path / "client.c").write_text(CLIENT)
    folder = lib.directory
    sources = sorted((folder / "src").glob("*.c"))
    options = [f"-I{folder}", "-O2", "-ffp-contract=off"]
    run(CC, *STRICT, *options, "client.c", *sources, "-lm", "-o", "client", folder=tmp_path)
    first, *numbers, last = run(tmp_path / "client", folder=tmp_path).splitlines()
    expected = lib.inverse_kinematics(*pose(lib, JOINTS), JOINTS)
    assert first == "0 8" and len(expected) == 8
    found = np.array([float.fromhex(x) for x in numbers]).reshape(8, 6)
    assert found.tobytes() == expected.tobytes() and np.abs(found[0] - JOINTS).max() < 1e-9
    assert last.split() == ["-5"] * 5 + ["-6", "-1", "-1", "-5", "-2", "0"]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["manutec_r3", "manutec_r3_18"])
def test_one_file_and_cpp_compile_without_a_warning(name, tmp_path):
    """The larger one also has unactuated coordinates, and with them all files of the inversion."""
    made = flexgen.generate(name, tmp_path, amalgamate=True, build=False)
    text = (made.directory / f"{name}.h").read_text()
    assert f"{name}_inverse_kinematics(" in text and f"{name}_invert(" in text
    run(CC, *STRICT, "-fsyntax-only", f"{name}.c", folder=tmp_path)
    (tmp_path / "include.cpp").write_text(f'#include "{name}.h"\nint main() {{ return 0; }}\n')
    run(tool("g++"), *STRICT_CPP, "-fsyntax-only", "include.cpp", folder=tmp_path)


@pytest.mark.parametrize("isa", ["x86-64-v2", "x86-64-v3", "x86-64-v4"])
def test_every_instruction_set_gives_the_same_bits(isa):
    compiler = find_compiler(isa=isa)
    if compiler is None or processor.missing_instruction_sets(compiler.instruction_sets):
        pytest.skip(f"this processor has not all instructions of {isa}")
    one = library("ur5", "x86-64")
    other = library("ur5", isa)
    for seed in range(5):
        q = np.random.default_rng(seed).uniform(-3, 3, 6)
        assert (
            one.inverse_kinematics(*pose(one, q)).tobytes()
            == other.inverse_kinematics(*pose(one, q)).tobytes()
        )


def test_the_nearest_is_first_and_turns_follow_the_start():
    lib = library("manutec_r3")
    turned = JOINTS + 2 * np.pi * np.array([1, 0, 0, -1, 0, 2])
    found = lib.inverse_kinematics(*pose(lib, JOINTS), turned)
    far = np.abs(found - turned).max(axis=1)
    assert (
        np.abs(found[0] - turned).max() < 1e-9
        and np.all(np.diff(far) >= 0)
        and far[-1] <= np.pi + 1e-9
    )
    assert (
        lib.inverse_kinematics(*pose(lib, JOINTS), turned, most=3).tobytes() == found[:3].tobytes()
    )


def test_one_start_continues_a_motion():
    """Along a line of joints, from sample to sample: the same branch, 0.05 rad apart, to
    rounding.
    """
    lib = library("ur5")
    q = np.array([0.3, -1.1, 1.0, 0.4, 0.8, -0.2])
    for k in range(1, 20):
        true = np.array([0.3, -1.1, 1.0, 0.4, 0.8, -0.2]) + 0.05 * k * np.array(
            [1, -0.5, 0.3, -1, 0.4, 1]
        )
        found = lib.inverse_kinematics(*pose(lib, true), q, starts=1)
        assert len(found) == 1 and np.abs(found[0] - true).max() < 1e-10
        q = found[0]


def test_all_other_coordinates_keep_their_values():
    """Deflections of an elastic arm, and the third joint of an arm with seven."""
    lib = library("panda")
    rng = np.random.default_rng(0)
    q = rng.uniform(-1, 1, 7)
    free = [0, 1, 3, 4, 5, 6]
    found = lib.inverse_kinematics(*pose(lib, q), q, free=free)
    assert np.all(found[:, 2] == q[2]) and np.abs(found[0] - q).max() < 1e-9
    with pytest.raises(ArgumentError, match="free: given none for 7 coordinates with a motor"):
        lib.inverse_kinematics(*pose(lib, q), q)


def test_wrong_arguments_are_refused():
    lib = library("manutec_r3")
    p, R = pose(lib, JOINTS)
    for words, given, named in (
        ("not a rotation", (p, 1.01 * R), {}),
        ("p: ", (p[:2], R), {}),
        ("starts: given 0", (p, R), {"starts": 0}),
        ("most: given True", (p, R), {"most": True}),
        ("six different indices", (p, R), {"free": [0, 1, 2, 3, 4, 4]}),
        (r"\|q_start\| > 1000", (p, R, JOINTS + 1000), {}),
        ("six different indices from 0 to 5", (p, R), {"free": [0, 1, 2, 3, 4, 9]}),
        ("six different indices", (p, R), {"free": [0.9, 1.2, 2, 3, 4, 5]}),
        ("six different indices", (p, R), {"free": 5}),
        ("six different indices", (p, R), {"free": [2**32, 1, 2, 3, 4, 5]}),
    ):
        with pytest.raises(ArgumentError, match=words):
            lib.inverse_kinematics(*given, **named)
    assert lib.inverse_kinematics(p + 10, R).shape == (0, 6)
    stretched = pose(lib, np.array([0.3, -1.1, 1.0, 0.4, 0.0, -0.2]))  # axes four and six are one
    with pytest.raises(
        SolverError, match="more than 16 configurations at this pose, which is singular"
    ):
        lib.inverse_kinematics(*stretched)
    assert pickle.loads(pickle.dumps(lib.inverse_kinematics))(p, R).shape == (8, 6)
    with pytest.raises(ArgumentError, match="expected one in double precision"):
        library("elbow").inverse_kinematics(p, R)
    own = flexgen.load(lib.directory)
    poses = own.inverse_kinematics
    own.close()
    with pytest.raises(ArgumentError, match="closed"):
        poses(p, R)


def test_poses_with_a_stretched_elbow_are_solved():
    """Near a singularity convergence is linear: the true joints are found, once, with an error
    below 1e-12.
    """
    lib = library("ur5")
    rng = np.random.default_rng(4)
    for k in range(60):
        q = rng.uniform(-np.pi, np.pi, 6)
        q[2] = (0.0, 1e-9, 1e-6, 1e-4)[k % 4]
        found = lib.inverse_kinematics(*pose(lib, q))
        near = np.abs(np.remainder(found - q + np.pi, 2 * np.pi) - np.pi).max(axis=1)
        assert near.min() < 1e-5, (k, near)  # configurations that are closer are one
        for one in found:
            p, R = pose(lib, one)
            assert (
                np.abs(p - pose(lib, q)[0]).max() < 1e-12
                and np.abs(R - pose(lib, q)[1]).max() < 2e-12
            )
        apart = np.abs(np.remainder(found[:, None] - found[None] + np.pi, 2 * np.pi) - np.pi).max(
            axis=2
        )
        assert apart[~np.eye(len(found), dtype=bool)].min(initial=1.0) > 1e-5


@pytest.mark.parametrize("output", ["tool_pose", "tool_position"])
def test_the_function_exists_for_outputs_that_do_not_determine_the_joints(output, tmp_path):
    """Seven joints for a pose, six for a position: no inverse dynamics of a path, but
    configurations.
    """
    given = ROBOTS / "panda.toml" if output == "tool_pose" else "manutec_r3"
    model = flexgen.read(given, overrides={"output": {"type": output}})
    assert model.inversion_obstacle() is not None
    lib = flexgen.load(flexgen.generate(model, tmp_path, functions=POINT).directory)
    q = np.linspace(-0.6, 0.9, model.n_a)
    found = lib.inverse_kinematics(*pose(lib, q), q, free=[0, 1, *range(model.n_a - 4, model.n_a)])
    assert np.abs(found[0] - q).max() < 1e-8


AXES = {"x": [1, 0, 0], "y": [0, 1, 0], "z": [0, 0, 1]}
GANTRY = """\
name = "gantry"
description = "three translations without limits, and a wrist"
gravity = [0.0, 0.0, -9.81]
home_rad = [0.0, 0.0, 0.0, 0.0, 0.5, 0.0]
"""


def test_translations_of_many_meters_are_solved(tmp_path):
    text = GANTRY
    for k, (kind, axis) in enumerate(
        [*(("translation", a) for a in "xyz"), *(("rotation", a) for a in "zyz")]
    ):
        text += (
            f'[[element]]\nname = "link{k}"\nbody = {{ mass = 1.0, inertia = [0.1, 0.1, 0.1] }}\n'
        )
        text += (
            "[[element.dof]]\n"
            f'name = "q{k}"\n'
            f'type = "{kind}"\n'
            f"axis = {AXES[axis]}\n"
            'gear = { type = "rigid" }\n'
        )
    text += "".join(
        f'[[motor]]\nname = "m{k}"\ndrives = "q{k}"\nratio = 10\ninertia = 1e-4\n'
        for k in range(6)
    )
    text += '[tool]\nposition = [0.1, 0.05, 0.2]\n[output]\ntype = "tool_pose"\n'
    (tmp_path / "gantry.toml").write_text(text)
    made = flexgen.generate(
        flexgen.read(tmp_path / "gantry.toml"), tmp_path / "made", functions=POINT
    )
    lib = flexgen.load(made.directory)
    rng = np.random.default_rng(1)
    for _ in range(20):
        q = np.concatenate([rng.uniform(-30, 30, 3), rng.uniform(-1.5, 1.5, 3)])
        found = lib.inverse_kinematics(*pose(lib, q))
        assert len(found) == 2 and min(np.abs(x - q).max() for x in found) < 1e-9


@pytest.mark.slow
def test_random_calls_with_status_ok_reach_their_pose(tmp_path):
    """4,000 calls with damaged poses, starts and indices, under sanitizers: what is found is at
    the pose.
    """
    if not can_sanitize(tmp_path):
        pytest.skip("no sanitizers; install the Debian package gcc")
    lib = library("panda")
    program = ROBOTS.parent / "programs" / "hostile_poses.c"
    sources = sorted((lib.directory / "src").glob("*.c"))
    options = [f"-I{lib.directory}", "-O1", "-ffp-contract=off", *SANITIZE]
    run(CC, *STRICT, *options, program, *sources, "-lm", "-o", "hostile", folder=tmp_path)
    seen = dict(
        map(int, line.split()) for line in run(tmp_path / "hostile", folder=tmp_path).splitlines()
    )
    assert sum(seen.values()) == 4000 and {0, -2, -5, -7} <= seen.keys() and seen[0] > 500


PLANTED = {
    "few starts": ("FRUITLESS = 256", "FRUITLESS = 16"),
    "turns are not wrapped": ("x - 2.0 * PI * floor_1((x + PI) / (2.0 * PI))", "x"),
    "the error of the rotation has a wrong sign": ("E[k][j] - E[j][k]", "E[j][k] - E[k][j]"),
}


@pytest.mark.parametrize("bug", PLANTED)
def test_a_planted_bug_is_seen(bug, monkeypatch):
    """Solutions are lost or appear twice in the counts of forty poses of ur5: 2, 4, 6 or 8, with
    the true one.
    """
    files = dict(kinematics_header.read_clib())
    text = files["inverse_kinematics.c"]
    assert text.count(PLANTED[bug][0]) == 1 and wrong_poses(library("ur5")) == 0
    monkeypatch.setattr(
        kinematics_header,
        "read_clib",
        lambda: files | {"inverse_kinematics.c": text.replace(*PLANTED[bug])},
    )
    made = flexgen.generate(
        ROBOTS / "ur5.toml", _folder() / "planted", functions=POINT, force=True
    )
    assert wrong_poses(flexgen.load(made.directory)) > 0


def wrong_poses(lib: Library) -> int:
    rng = np.random.default_rng(3)
    wrong = 0
    for _ in range(40):
        q = rng.uniform(-np.pi, np.pi, 6)
        try:
            found = lib.inverse_kinematics(*pose(lib, q))
        except SolverError:  # more than sixteen
            wrong += 1
            continue
        near = np.abs(np.remainder(found - q + np.pi, 2 * np.pi) - np.pi).max(axis=1) < 1e-6
        wrong += len(found) not in (2, 4, 6, 8) or near.sum() != 1
    return wrong
