"""The ROS 2 package: it compiles against stub headers, and gives the bits of the library and of
the Python controller.

The headers in tests/support/ros2_stubs have the signatures of the public interfaces. Nothing here
runs ROS 2.
"""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
import sysconfig
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest
import remembering
from emitted import loaded
from exports import library_object, without_streams
from toolchain import needs_compiler, tool

import flexgen
from flexgen.base.errors import ArgumentError, BuildError
from flexgen.cli.main import main
from flexgen.codegen.emission.clib_files import render
from flexgen.dynamics.mechanics.statics import hold_joints
from flexgen.exports.c_code.emitted import emit
from flexgen.exports.c_code.selftest.golden import output_at
from flexgen.exports.c_code.selftest.motion import targets
from flexgen.feedback.loop.controllers import Cascade
from flexgen.studies.templates.new_model import new_model

STUBS = Path(__file__).resolve().parents[1] / "support" / "ros2_stubs"
STRICT = ["-std=c++17", "-Wall", "-Wextra", "-Werror", "-O0"]
NAME = "planar5_nmp"
ROS = "flexgen_planar5_nmp"
N_M = 2
N_A = 3
OBJECTS: dict[str, bytes] = {}


def eigen() -> Path:
    """The folder with eigen3/Eigen; skips the test where it is missing."""
    for folder in (
        Path(sysconfig.get_paths()["purelib"]) / "cmeel.prefix" / "include",
        Path("/usr/include"),
    ):
        if (folder / "eigen3" / "Eigen" / "Core").exists():
            return folder
    pytest.skip(
        "no Eigen; install the Python package cmeel-eigen or the Debian package libeigen3-dev"
    )


def compiled(
    folder: Path, *sources: Path, flags: tuple[str, ...] = (), package: str = ROS
) -> list[str]:
    """Object files of C++ sources of a package; equal ones, of copies with a planted error
    elsewhere, are made once.
    """
    out = []
    headers = {
        path.relative_to(folder): path.read_bytes() for path in (folder / "include").rglob("*.hpp")
    }
    include = ["-isystem", eigen(), "-isystem", eigen() / "eigen3", "-I", STUBS]
    include += ["-I", folder / "include", "-I", folder / "include" / package]
    for source in sources:
        out.append(str(folder / f"{source.stem}.o"))
        key = repr((source.read_bytes(), sorted(headers.items()), flags, package))
        if key in OBJECTS:
            Path(out[-1]).write_bytes(OBJECTS[key])
            continue
        command = [
            tool("g++"),
            *STRICT,
            *flags,
            '-DFIRST_MOTOR="m1"',
            *include,
            "-c",
            source,
            "-o",
            out[-1],
        ]
        subprocess.run(command, check=True)
        OBJECTS[key] = Path(out[-1]).read_bytes()
    return out


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """The package of planar5_nmp."""
    folder = tmp_path_factory.mktemp("ros2")
    flexgen.export_ros2(NAME, folder, gains=None)
    return folder


def objects_of(package: Path, name: str, parts: tuple[str, ...] = ()) -> list[str]:
    """Object files of a program that drives plugin and controller, without the library."""
    text = (STUBS / "drive.cpp").read_text(encoding="ascii")
    ros = f"flexgen_{name}"
    (package / "drive.cpp").write_text(
        render(text, name, parts=parts).replace("flexgen_model", ros)
    )
    sources = (package / "src" / "inverse_dynamics.cpp", package / "src" / "stream_controller.cpp")
    return compiled(package, *sources, package / "drive.cpp", package=ros)


@pytest.fixture(scope="module")
def driver(package):
    """A program that drives plugin and controller."""
    objects = objects_of(package, NAME)
    subprocess.run(
        [tool("g++"), *objects, library_object(NAME)[1], "-o", package / "drive"], check=True
    )
    return package / "drive"


def drive(program: Path, mode: str, numbers: np.ndarray, expected: int = 0) -> np.ndarray:
    """Numbers that the program writes to its standard output."""
    run = subprocess.run(
        [program, mode],
        input=np.asarray(numbers, float).tobytes(),
        capture_output=True,
        check=False,
    )
    assert run.returncode == expected, run.stderr.decode()
    return np.frombuffer(run.stdout)


# --- the plugin ----------------------------------------------------------------------------------
@needs_compiler
@pytest.mark.slow
def test_the_plugin_has_the_bits_of_the_library(driver):
    library = loaded(NAME)
    rng = np.random.default_rng(3)
    n = 20
    q, v, a, wrench = (rng.normal(size=(n, k)) for k in (N_A, N_A, N_A, 6))
    out = drive(driver, "plugin", np.hstack([q, v, a, wrench])).reshape(n, -1)
    parts = np.split(out, np.cumsum([N_A] * 6), axis=1)
    torques, with_wrench, c, g, f, external, M = parts
    assert np.array_equal(
        torques, [library.inverse_dynamics(*x) for x in zip(q, v, a, strict=True)]
    )
    assert np.array_equal(g, [library.gravity(x) for x in q])
    assert np.array_equal(
        M.reshape(n, N_A, N_A).transpose(0, 2, 1), [library.mass_matrix(x) for x in q]
    )
    # sums in the program and in numpy may be in another order
    near = {"rtol": 1e-13, "atol": 1e-11}
    assert np.allclose(c, np.array([library.bias(*x) for x in zip(q, v, strict=True)]) - g, **near)
    J = np.array([library.jacobian(x) for x in q])
    assert np.allclose(external, np.einsum("kij,ki->kj", J, wrench), **near)
    assert np.allclose(with_wrench, torques + external, **near)
    eta = flexgen.read(NAME).eta
    friction = np.array([eta.T @ library.motor_friction(eta @ x[:N_M]) for x in v])
    assert np.abs(friction).max() > 0 or not f.any()
    assert np.allclose(f[:, :N_M], friction, **near) and not f[:, N_M:].any()


# --- the controller ------------------------------------------------------------------------------
PARTS = 5
PERIOD = 0.005
INTERVALS = 10


def gains(torque_max: float = 0.0) -> Cascade:
    given = (np.array(x) for x in ([9.0, 11.0], [0.8, 0.5], [2.0, 3.0]))
    return Cascade(*given, torque_max=np.full(2, torque_max))


def reference_run(cascade, samples, positions, missing=()):
    """Reference in Python for the controller: the efforts at every update."""
    library = loaded(NAME)
    q_a = np.append(flexgen.read(NAME).home, 0.0)
    zero = np.zeros(2)
    y0 = output_at(flexgen.derive(NAME), q_a)  # where the controller starts
    options = {
        "period": PERIOD,
        "intervals": INTERVALS,
        "samples_per_interval": PARTS,
        "hold": "zoh",
    }
    stream = library.stream(y0, q_a, **options)
    interval = stream.update(y0, zero, zero)
    rest = interval.q_m[0].copy()
    cascade.begin(PERIOD / PARTS)
    cascade.reset()
    held = y0
    out = []
    none = np.zeros(0)
    for k, offset in enumerate(positions):
        if k % PARTS == 0:
            y, dy, ddy = (x[k // PARTS] for x in samples)
            if k // PARTS in missing:
                y = held
                dy = zero
                ddy = zero
            interval = stream.update(y, dy, ddy)
            held = y
        part = k % PARTS
        q_m = interval.q_m[part]
        tau_m = interval.tau_m[part]
        if k == 0:  # at rest, where the stream starts
            cascade.step(
                0,
                flexgen.Measurement(rest, none),
                flexgen.Reference(rest, none, tau_m, none, none, none),
            )
        u = cascade.step(
            k,
            flexgen.Measurement(rest + offset, none),
            flexgen.Reference(q_m, none, tau_m, none, none, none),
        )
        most = cascade.torque_max
        out.append(np.clip(u, -most, most) if most is not None and (most > 0).all() else u)
    return np.array(out), rest


def path_samples(n):
    path = flexgen.plan(NAME)
    sample = path.sample(np.maximum(np.arange(n) - 1, 0) * PERIOD)
    return targets(sample), sample.derivative(1), sample.derivative(2)


def controller_input(
    cascade, samples, positions, rest, *, chained, missing=(), tolerance=1e-3, start=None
):
    n = len(positions)
    rows = [[float(chained), 50.0, float(n)]]
    rows += [
        cascade.position_gain,
        cascade.speed_gain,
        cascade.integral_gain,
        cascade.torque_max,
        [tolerance],
    ]
    rows += [rest if start is None else start]
    for k, offset in enumerate(positions):
        at = k // PARTS
        given = float(k % PARTS == 0 and at not in missing)
        rows += [rest + offset, [given], *(x[at] for x in samples)]
    return np.concatenate([np.asarray(row, float) for row in rows])


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("chained", [True, False])
@pytest.mark.parametrize(("torque_max", "missing"), [(0.0, ()), (8.0, ()), (0.0, (60, 61, 90))])
def test_the_controller_has_the_bits_of_python_and_allocates_nothing(
    driver, chained, torque_max, missing
):
    cascade = gains(torque_max)
    n = 130
    samples = path_samples(n)
    rng = np.random.default_rng(5)
    positions = np.cumsum(1e-3 * rng.normal(size=(n * PARTS, N_M)), axis=0)
    expected, rest = reference_run(cascade, samples, positions, missing)
    given = controller_input(cascade, samples, positions, rest, chained=chained, missing=missing)
    out = drive(driver, "controller", given)
    assert out[-1] == 0, f"{out[-1]:.0f} allocations in {n * PARTS} updates"
    efforts = out[:-1].reshape(-1, N_M)
    assert np.array_equal(efforts, expected)
    # the robot moves, and the limit is reached
    assert np.abs(efforts).max() > (7.9 if torque_max else 10.0)


@needs_compiler
@pytest.mark.slow
def test_a_planted_error_of_the_controller_is_seen(package, driver, tmp_path):
    """The torque of the next sample instead of this one."""
    text = (package / "src" / "stream_controller.cpp").read_text(encoding="ascii")
    changed = text.replace("tau_m_.begin() + static_cast<std::ptrdiff_t>(at)", "tau_m_.begin()")
    assert changed != text
    (tmp_path / "stream_controller.cpp").write_text(changed)
    for folder in ("include", "src"):
        (tmp_path / folder).symlink_to(package / folder)
    objects = compiled(tmp_path, tmp_path / "stream_controller.cpp")
    objects += [str(package / f"{stem}.o") for stem in ("inverse_dynamics", "drive")]
    subprocess.run(
        [tool("g++"), *objects, library_object(NAME)[1], "-o", tmp_path / "drive"], check=True
    )
    cascade = gains()
    samples = path_samples(130)
    positions = np.zeros((650, N_M))
    expected, rest = reference_run(cascade, samples, positions)
    out = drive(
        tmp_path / "drive",
        "controller",
        controller_input(cascade, samples, positions, rest, chained=True),
    )
    assert not np.array_equal(out[:-1].reshape(-1, N_M), expected)


@needs_compiler
@pytest.mark.slow
def test_gears_and_motors_with_memory_have_the_torques_of_solve(tmp_path):
    """A controller without feedback; what its stream forgets from update to update is seen."""
    flexgen.export_ros2(remembering.remembering(), tmp_path, gains=None)
    objects = objects_of(tmp_path, "elbow")
    given = remembering.samples()
    n = len(given[0])
    none = Cascade(*np.zeros((3, 2)), torque_max=np.zeros(2))
    rest = hold_joints(flexgen.derive("elbow"), remembering.start()[1]).q_m
    numbers = controller_input(none, given, np.zeros((n * PARTS, 2)), rest, chained=True)

    def torques(forgets: str) -> np.ndarray:
        program = tmp_path / f"drive{forgets}"
        subprocess.run(
            [tool("g++"), *objects, remembering.compiled(forgets), "-o", program], check=True
        )
        return drive(program, "controller", numbers)[:-1].reshape(-1, 2)

    remembering.check(torques, "zoh")
    run = subprocess.run(
        [tmp_path / "drive", "plugin"],
        input=np.zeros(12).tobytes(),
        capture_output=True,
        check=False,
    )
    assert b"motor m1 has lugre, which depends on the motion before" in run.stderr


@needs_compiler
@pytest.mark.slow
def test_the_controller_refuses_another_start_pose(driver):
    cascade = gains()
    samples = path_samples(2)
    positions = np.zeros((5, N_M))
    _, rest = reference_run(cascade, samples, positions)
    away = controller_input(
        cascade, samples, positions, rest, chained=True, start=rest + np.array([0.0, 2e-3])
    )
    run = subprocess.run(
        [driver, "controller"], input=away.tobytes(), capture_output=True, check=False
    )
    assert run.returncode == 10 and b"move the robot there first" in run.stderr


@needs_compiler
@pytest.mark.slow
def test_an_offset_of_the_start_pose_gives_no_speed(driver):
    """The robot rests next to the planned start: u - tau_ff = -k_s k_p d (1 + k_i t), t since the
    activation.
    """
    cascade = gains()
    n = 130
    away = np.array([4e-4, -7e-4])
    samples = path_samples(n)
    offsets = np.zeros((n * PARTS, N_M))
    expected, rest = reference_run(cascade, samples, offsets)
    given = controller_input(
        cascade, samples, offsets + away, rest, chained=True, start=rest + away
    )
    efforts = drive(driver, "controller", given)[:-1].reshape(-1, N_M)
    t = PERIOD / PARTS * np.arange(1, n * PARTS + 1)[:, None]
    shift = -cascade.speed_gain * cascade.position_gain * away * (1.0 + cascade.integral_gain * t)
    # angles of about 1 rad differ by 1e-16 rad, which is 1e-13 N m after the division by 1 ms
    assert np.allclose(efforts - expected, shift, rtol=0, atol=1e-10)


@needs_compiler
@pytest.mark.slow
def test_an_error_of_an_update_sets_the_efforts_to_zero(driver):
    """The program returns 11 where they are 0 after an error, 12 where not; after the deactivation
    it returns 13.
    """
    cascade = gains()
    samples = path_samples(4)
    positions = np.zeros((20, N_M))
    _, rest = reference_run(cascade, samples, positions)
    positions[12, 1] = np.nan  # the sensor fails
    efforts = drive(
        driver, "controller", controller_input(cascade, samples, positions, rest, chained=True), 11
    )
    assert efforts.size == 12 * N_M and np.abs(efforts[-N_M:]).max() > 1.0


@needs_compiler
@pytest.mark.slow
def test_the_test_of_the_package_passes_and_sees_a_wrong_torque(package, driver, tmp_path):
    """`test/test_plugin.cpp` compares with Lagrange's equations."""
    for wrong in (False, True):
        objects = compiled(package, package / "test" / "test_plugin.cpp")
        objects += [str(package / "inverse_dynamics.o"), str(library_object(NAME)[1])]
        subprocess.run([tool("g++"), *objects, "-o", tmp_path / "run"], check=True)
        assert subprocess.run([tmp_path / "run"], capture_output=True, check=False).returncode == (
            3 if wrong else 0
        )
        header = package / "include" / ROS / "arm.hpp"
        kept = header.read_text(encoding="ascii")
        if not wrong:
            torques = re.search(r"HOME_TORQUES = \{(.*)\}", kept)[1]
            shifted = ", ".join(repr(float(x) + 1e-5) for x in torques.split(","))
            header.write_text(kept.replace(torques, shifted), encoding="ascii")
        else:
            header.write_text(kept.replace(shifted, torques), encoding="ascii")


# --- a force on the tool -------------------------------------------------------------------------
@pytest.fixture(scope="module")
def pushed(tmp_path_factory):
    """The package with the part force, and a library of it."""
    folder = tmp_path_factory.mktemp("pushed")
    flexgen.export_ros2(NAME, folder / "ros2", gains=None, parts=["force"])
    made = flexgen.generate(NAME, folder / "library", parts=["force"], progress=False)
    return folder / "ros2", flexgen.load(made.directory)


WRENCHES = {12: (30.0, -40.0), 20: (10.0, 5.0), 30: (0.0, 60.0)}  # messages: interval, force [N]
CHANGE = 20  # intervals, 0.1 s


def forces_of_messages(n: int) -> np.ndarray:
    """Force and two derivatives (n, 3, 2) from the messages, by polynomials of numpy."""
    s = np.polynomial.Polynomial([0, 0, 0, 10, -15, 6])
    out = np.zeros((n, 3, 2))
    value = np.zeros(2)
    target = np.zeros(2)
    waiting = np.zeros(2)
    begin = -1
    for k in range(-1, n):  # the activation takes an interval before the first update
        waiting = np.array(WRENCHES.get(k, waiting))
        if (k + 1) % CHANGE == 0:
            value = target
            target = waiting
            begin = k
        for order in range(3 if k >= 0 else 0):
            rate = s.deriv(order)((k - begin + 1) / CHANGE) / (CHANGE * PERIOD) ** order
            out[k, order] = (value if order == 0 else 0.0) + (target - value) * rate
    return out


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize(("chained", "planted"), [(True, False), (False, False), (True, True)])
def test_the_force_of_samples_and_messages_reaches_the_stream(pushed, tmp_path, chained, planted):
    """The torques of a stream of Python with the sum of both; planted: the other sign of the
    messages.
    """
    (folder, library) = pushed
    n = 130
    package = tmp_path / "ros2"
    shutil.copytree(folder, package)
    if planted:
        source = package / "src" / "stream_controller.cpp"
        text = source.read_text(encoding="ascii")
        assert "force[i] = wrench[row];" in text
        source.write_text(
            text.replace("force[i] = wrench[row];", "force[i] = -wrench[row];"), encoding="ascii"
        )
    objects = objects_of(package, NAME, ("FORCE",))
    program = library_object(NAME, parts=("force",))[1]
    subprocess.run([tool("g++"), *objects, program, "-o", package / "drive"], check=True)
    samples = path_samples(n)
    t = PERIOD * np.arange(n)
    own = np.stack([20.0 * t**3, 60.0 * t**2, 120.0 * t], axis=1)[:, :, None] * np.array(
        [1.0, -2.0]
    )
    sums = own + forces_of_messages(n)
    zero = np.zeros(2)
    q_a = np.append(flexgen.read(NAME).home, 0.0)
    y0 = output_at(flexgen.derive(NAME), q_a)
    stream = library.stream(
        y0, q_a, period=PERIOD, intervals=INTERVALS, samples_per_interval=PARTS, hold="zoh"
    )
    rest = stream.update(y0, zero, zero).q_m[0].copy()
    expected = []
    rows = [[float(chained), 50.0, float(n * PARTS)], *np.zeros((4, 2)), [1e-3], rest]
    for k in range(n):
        stream.set_force(sums[k].ravel())
        expected.append(stream.update(*(x[k] for x in samples)).tau_m[:PARTS])
        for part in range(PARTS):
            wrench = [*WRENCHES.get(k, (0.0, 0.0)), 0.0, 0.0, 0.0, 0.0]
            rows += [rest, [float(part == 0)], *(x[k] for x in samples), own[k].ravel()]
            rows += [[float(part == 0 and k in WRENCHES)], wrench]
    out = drive(
        package / "drive", "controller", np.concatenate([np.asarray(row, float) for row in rows])
    )
    assert out[-1] == 0  # allocations
    difference = np.abs(out[:-1].reshape(-1, N_M) - np.concatenate(expected)).max()
    assert difference > 1.0 if planted else difference < 1e-9


@pytest.mark.slow
def test_the_package_with_a_force_is_well_formed(pushed, tmp_path):
    import yaml

    folder = pushed[0]
    texts = {
        p.relative_to(folder).as_posix(): p.read_text("ascii")
        for p in folder.rglob("*")
        if p.is_file()
    }
    for file, text in texts.items():
        assert not re.search(r"@[A-Z_]+ ?@|flexgen_model|FLEXGEN_MODEL|\bmodel_|\bMODEL_", text), (
            file
        )
    config = yaml.safe_load(texts["config/controller.yaml"])["stream_controller"][
        "ros__parameters"
    ]
    assert config["wrench_time"] == 0.1
    needed = {e.text for e in ElementTree.fromstring(texts["package.xml"]).iter("depend")}
    used = set(re.findall(r"find_package\((\w+) REQUIRED", texts["CMakeLists.txt"]))
    assert {x for x in used if not x.startswith("ament") and x != "Eigen3"} == needed - {"eigen"}
    assert "geometry_msgs" in needed and "WRENCH_ROWS = {0, 1}" in texts[f"include/{ROS}/arm.hpp"]
    for name, options, words in (
        (NAME, {"parts": ["bvp"]}, "parts: given bvp, expected some of force, limits"),
        (
            NAME,
            {"parts": ["force"], "controller": False},
            "expected some of force, limits, position, and a controller",
        ),
        ("four_mass", {"parts": ["force"]}, "whose output is none of the tool"),
    ):
        with pytest.raises(ArgumentError, match=words):
            flexgen.export_ros2(name, tmp_path / "a", **options)
    assert not (tmp_path / "a").exists()


# --- limits --------------------------------------------------------------------------------------
CURVE = [[0.0, 40.0], [300.0, 30.0], [600.0, 0.0]]
LIMITED = {
    "motor.m1.torque_max": 22.0,
    "motor.m2.torque_speed": CURVE,
    "motor.m2.torque_rate_max": 2000.0,
}
LIMITED |= {f"element.arm{k}.dof.q{k}.gear.torque_max": x for k, x in ((1, 1700.0), (2, 400.0))}


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("planted", [False, True])
def test_the_stream_keeps_the_limits_of_the_model(tmp_path, planted):
    """The torques of a stream of Python with these limits; planted: those of gears and of rates
    swapped.
    """
    import yaml

    model = flexgen.read(NAME, overrides=LIMITED)
    n = 130
    package = tmp_path / "ros2"
    flexgen.export_ros2(model, package, gains=None, parts=["limits"])
    text = (package / "config" / "controller.yaml").read_text(encoding="ascii")
    limits = yaml.safe_load(text)["stream_controller"]["ros__parameters"]["limits"]
    assert (
        limits["torque_max"] == [22.0, 40.0]
        and limits["torque_speed"][-6:] == np.ravel(CURVE).tolist()
    )
    assert (
        limits["gear_torque_max"] == [1700.0, 400.0]
        and limits["tool_speed_max"] == limits["speed_max"][0] == 0.0
    )
    if planted:
        source = package / "src" / "stream_controller.cpp"
        text = source.read_text(encoding="ascii")
        a = "::gear_torque_max}"
        b = "::torque_rate_max}"
        assert text.count(a) == text.count(b) == 1
        source.write_text(text.replace(a, "::@").replace(b, a).replace("::@", b), encoding="ascii")
    objects = objects_of(package, NAME, ("LIMITED",))
    program = tmp_path / "library.o"
    include = package / "include" / ROS
    source = package / "src" / f"{NAME}.c"
    subprocess.run(
        [tool("gcc"), "-std=c99", "-O0", f"-I{include}", "-c", source, "-o", program], check=True
    )
    subprocess.run([tool("g++"), *objects, program, "-o", package / "drive"], check=True)
    library = flexgen.load(
        flexgen.generate(model, tmp_path / "c", parts=["limits"], progress=False).directory
    )
    zero = np.zeros(2)
    q_a = np.append(model.home, 0.0)
    samples = path_samples(n)
    y0 = output_at(flexgen.derive(model), q_a)
    stream = library.stream(
        y0, q_a, period=PERIOD, intervals=INTERVALS, samples_per_interval=PARTS, hold="zoh"
    )
    stream.limit_all(**flexgen.Limits.from_model(model).for_library(model))
    rest = stream.update(y0, zero, zero).q_m[0].copy()
    updates = [stream.update(*(x[k] for x in samples)) for k in range(n)]
    rows = [[1.0, 50.0, float(n * PARTS)], *np.zeros((4, 2)), [1e-3], rest]
    for k in range(n):
        for part in range(PARTS):
            rows += [rest, [float(part == 0)], *(x[k] for x in samples)]
    out = drive(
        package / "drive", "controller", np.concatenate([np.asarray(row, float) for row in rows])
    )
    assert out[-1] == 0  # allocations
    assert sum(x.limits_active for x in updates) > 10
    difference = np.abs(
        out[:-1].reshape(-1, N_M) - np.concatenate([x.tau_m[:PARTS] for x in updates])
    ).max()
    assert difference > 1e-3 if planted else difference == 0.0


# --- the files -----------------------------------------------------------------------------------
def test_the_files_are_well_formed_and_complete(package):
    import yaml

    texts = {
        p.relative_to(package).as_posix(): p.read_text("ascii")
        for p in package.rglob("*")
        if p.suffix != ".o" and p.is_file() and p.name != "drive"
    }
    for file, text in texts.items():
        if file == "drive.cpp":
            continue
        assert not re.search(r"@[A-Z_]+ ?@|flexgen_model|FLEXGEN_MODEL|\bmodel_|\bMODEL_", text), (
            file
        )
        if file.endswith(".xml"):
            ElementTree.fromstring(text)
    ast.parse(texts["launch/stream_controller.launch.py"])
    config = yaml.safe_load(texts["config/controller.yaml"])
    assert config["controller_manager"]["ros__parameters"]["update_rate"] == 1000
    parameters = config["stream_controller"]["ros__parameters"]
    assert parameters["joints"] == ["m1", "m2"] and "speed_gain" not in parameters
    assert set(
        re.findall(r'auto_declare<[\w:<>]+>\(\s*"(\w+)"', texts["src/stream_controller.cpp"])
    ) >= set(parameters)
    tree = ElementTree.fromstring(texts["package.xml"])
    needed = {e.text for e in tree.iter("depend")}
    used = set(re.findall(r"find_package\((\w+) REQUIRED", texts["CMakeLists.txt"]))
    assert {x for x in used if not x.startswith("ament") and x != "Eigen3"} == needed - {"eigen"}
    for name, base in (
        ("InverseDynamics", "inverse_dynamics"),
        ("StreamController", "stream_controller"),
    ):
        file = f"{'inverse_dynamics' if base == 'inverse_dynamics' else 'controller'}_plugin.xml"
        (declared,) = ElementTree.fromstring(texts[file]).iter("class")
        exported = re.search(
            r"PLUGINLIB_EXPORT_CLASS\(\s*([\w:]+),\s*([\w:]+)\)", texts[f"src/{base}.cpp"]
        )
        assert exported.groups() == (declared.get("type"), declared.get("base_class_type"))
        assert declared.get("name") == f"{ROS}/{name}"
        assert (
            f"add_library({ElementTree.fromstring(texts[file]).get('path')} SHARED"
            in texts["CMakeLists.txt"]
        )


def test_gains_names_and_the_plugin_alone(tmp_path):
    import yaml

    flexgen.export_ros2(
        NAME,
        tmp_path / "a",
        package="my_arm",
        gains=gains(2.5),
        maintainer='<"A" & B>',
        license_name="X",
    )
    config = yaml.safe_load((tmp_path / "a" / "config" / "controller.yaml").read_text())
    found = config["stream_controller"]["ros__parameters"]
    assert found["speed_gain"] == [0.8, 0.5] and found["torque_max"] == [2.5, 2.5]
    tree = ElementTree.parse(tmp_path / "a" / "package.xml")
    assert tree.findtext("maintainer") == '<"A" & B>' and tree.findtext("name") == "my_arm"
    assert (
        "namespace flexgen_my_arm" in (tmp_path / "a" / "src" / "inverse_dynamics.cpp").read_text()
    )
    flexgen.export_ros2(NAME, tmp_path / "b", controller=False)
    files = {path.name for path in (tmp_path / "b").rglob("*")}
    assert "inverse_dynamics.cpp" in files and "stream_controller.cpp" not in files
    assert "std_msgs" not in (tmp_path / "b" / "package.xml").read_text()


@pytest.mark.parametrize("package", ["Arm", "arm__x", "2arm", "arm;rm -rf", "a" * 61, "arm_", 3])
def test_names_of_packages_are_checked(package, tmp_path):
    with pytest.raises(BuildError, match=r"package: given .*expected small letters"):
        flexgen.export_ros2(NAME, tmp_path, package=package)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("package", ["div", "signal"])
def test_a_package_may_have_the_name_of_a_function_of_c(package, tmp_path):
    flexgen.export_ros2(NAME, tmp_path, package=package)
    include = [
        "-isystem",
        eigen(),
        "-isystem",
        eigen() / "eigen3",
        "-I",
        STUBS,
        "-I",
        tmp_path / "include",
    ]
    include += ["-I", tmp_path / "include" / package]
    for source in (tmp_path / "src").glob("*.cpp"):
        command = [
            tool("g++"),
            *STRICT,
            "-include",
            "csignal",
            "-include",
            "cstdlib",
            *include,
            "-fsyntax-only",
            source,
        ]
        subprocess.run(command, check=True)
    described = ElementTree.parse(tmp_path / "inverse_dynamics_plugin.xml").find("class")
    assert described.get("name") == f"{package}/InverseDynamics"
    assert described.get("type") == f"flexgen_{package}::InverseDynamics"


@pytest.mark.parametrize(
    "package", ["class", "and_eq", "co_await", "std", "unix", "rclcpp", "eigen"]
)
def test_words_of_cpp_and_needed_packages_are_refused(package, tmp_path):
    with pytest.raises(
        BuildError, match=rf"package: given '{package}', which is .*'{package}_dynamics'"
    ):
        flexgen.export_ros2(NAME, tmp_path, package=package)
    assert not list(tmp_path.iterdir())


def test_names_equal_to_words_of_the_templates_are_kept(tmp_path):
    """Names as in the templates give the same files as other names, but for the names."""

    def renamed(text: str) -> str:
        return text.replace(NAME, "flexgen_model").replace(NAME.upper(), "FLEXGEN_MODEL")

    given = emit(NAME, streams=True)
    library = replace(
        given, name="flexgen_model", header=renamed(given.header), source=renamed(given.source)
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("flexgen.exports.ros2.export.emit", lambda *_, **__: library)
        flexgen.export_ros2(
            NAME, tmp_path / "a", package="model", maintainer="flexgen_model @RATE@"
        )
    flexgen.export_ros2(NAME, tmp_path / "b", package="zzz", maintainer="owner")
    for path in (
        p for p in (tmp_path / "a").rglob("*") if p.is_file() and p.name != "flexgen_export.json"
    ):
        relative = path.relative_to(tmp_path / "a").as_posix()
        other = relative.replace("include/model", "include/zzz").replace("flexgen_model", NAME)
        text = (
            renamed((tmp_path / "b" / other).read_text("ascii"))
            .replace("zzz", "model")
            .replace("ZZZ", "MODEL")
        )
        assert path.read_text("ascii") == text.replace("owner", "flexgen_model @RATE@"), relative


def test_wrong_arguments(tmp_path):
    with pytest.raises(ArgumentError, match="email: given 'x'"):
        flexgen.export_ros2(NAME, tmp_path, email="x")
    with pytest.raises(ArgumentError, match=r"gains, speed_gain: given .*expected 2 numbers"):
        flexgen.export_ros2(NAME, tmp_path, gains=Cascade(np.ones(2), np.ones(3), np.ones(2)))
    with pytest.raises(ArgumentError, match="given without a controller"):
        flexgen.export_ros2(NAME, tmp_path, controller=False, gains=gains())
    assert not list(tmp_path.iterdir())


def test_a_model_without_streams_is_refused(tmp_path):
    model = without_streams()
    with pytest.raises(ArgumentError, match=r"given a robot without streams, because"):
        flexgen.export_ros2(model, tmp_path)
    assert not list(tmp_path.iterdir())
    flexgen.export_ros2(model, tmp_path, controller=False)


def test_the_command_line(tmp_path, capsys):
    assert main(["export", "ros2", NAME, "--out", str(tmp_path), "-q"]) == 0
    assert "stream_controller.cpp" in capsys.readouterr().out
    # of a P-PI cascade
    assert "speed_gain: [" in (tmp_path / "config" / "controller.yaml").read_text()
    assert main(["export", "ros2", NAME, "--out", str(tmp_path), "--package", "A", "-q"]) == 1
    assert "small letters" in capsys.readouterr().err


# --- positions in place of torques ---------------------------------------------------------------
SERVO = {
    "type": "cascade",
    "position_gain": [30.0, 25.0],
    "speed_gain": [1.5, 0.4],
    "integral_gain": [6.0, 6.0],
    "sample_time": 1e-3,
    "delay": 4e-4,
}
IN_SERVO = 5  # samples of the servo in an interval


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """The package with the part position, and a library of it."""
    folder = tmp_path_factory.mktemp("served")
    model = flexgen.read(NAME, overrides={"servo": SERVO})
    exported = flexgen.export_ros2(model, folder / "ros2", parts=["position"])
    assert exported.notes == ()
    made = flexgen.generate(model, folder / "library", parts=["position"], progress=False)
    return folder / "ros2", flexgen.load(made.directory), model


def interpolation(n: int, each: int, cubic: bool) -> np.ndarray:
    """References (n, positions) of a servo between positions, as the comment of
    `position_samples.c` says.
    """
    count = (n - 1) // each + 1
    out = np.zeros((n, count))
    for k in range(n):
        j, x = divmod(k, each)
        x /= each
        weights = [0.0, 1.0 - x, x, 0.0]
        if cubic:
            a = x**3 - 2 * x**2 + x
            b = x**3 - x**2
            weights = [-a / 2, 2 * x**3 - 3 * x**2 + 1 - b / 2, 3 * x**2 - 2 * x**3 + a / 2, b / 2]
        for i, weight in enumerate(weights):
            out[k, min(max(j - 1 + i, 0), count - 1)] += weight
    return out


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize(
    ("each", "cubic", "chained", "planted"),
    [(1, False, True, False), (5, False, False, False), (5, True, True, True)],
)
def test_positions_are_those_of_the_stream_for_the_interface(
    served, tmp_path, each, cubic, chained, planted
):
    """Each in the middle of a window whose interpolation by numpy is closest; planted: the next
    one of the window.
    """
    (folder, library, model) = served
    n = 60
    ahead = 3
    package = tmp_path / "ros2"
    shutil.copytree(folder, package)
    if planted:
        header = package / "include" / ROS / "position_window.hpp"
        text = header.read_text(encoding="ascii")
        at = "static_cast<std::ptrdiff_t>(sides_) *"
        assert text.count(at) == 1
        header.write_text(
            text.replace(at, "static_cast<std::ptrdiff_t>(sides_ + 1) *"), encoding="ascii"
        )
    objects = objects_of(package, NAME, ("POSITION",))
    program = tmp_path / "library.o"
    include = package / "include" / ROS
    source = package / "src" / f"{NAME}.c"
    subprocess.run(
        [tool("gcc"), "-std=c99", "-O0", f"-I{include}", "-c", source, "-o", program], check=True
    )
    subprocess.run([tool("g++"), *objects, program, "-o", package / "drive"], check=True)
    samples = path_samples(n)
    zero = np.zeros(2)
    q_a = np.append(model.home, 0.0)
    y0 = output_at(flexgen.derive(NAME), q_a)
    options = {"period": PERIOD, "intervals": INTERVALS, "samples_per_interval": IN_SERVO}
    stream = library.stream(y0, q_a, **options, servo=True)
    first = stream.update(y0, zero, zero)
    rest = first.q_m[0].copy()
    commands = []
    rows = [
        [float(chained), 100.0, float(n * IN_SERVO // each), each, ahead, float(cubic), 1e-3],
        rest,
    ]
    for k in range(n):
        commands.append(stream.update(*(x[k] for x in samples)).command_m[:IN_SERVO])
        for part in range(0, IN_SERVO, each):
            rows += [rest, [float(part == 0)], *(x[k] for x in samples)]
    out = drive(
        package / "drive", "controller", np.concatenate([np.asarray(row, float) for row in rows])
    )
    assert out[-1] == 0  # allocations
    found = out[:-1].reshape(-1, N_M)
    expected = np.concatenate(commands)
    if each > 1:
        width = 2 * ahead * each + 1
        expected = np.concatenate([np.tile(first.command_m[:1], (width, 1)), expected])
        to_position = np.linalg.pinv(interpolation(width, each, cubic))[ahead]
        expected = np.array(
            [
                to_position @ expected[k + each : k + each + width]
                for k in range(0, n * IN_SERVO, each)
            ]
        )
    assert np.ptp(found, axis=0).min() > 5.0
    difference = np.abs(found - expected).max()
    assert difference > 1e-3 if planted else difference < 1e-9


def test_positions_need_a_servo_and_no_gains(tmp_path):
    with pytest.raises(ArgumentError, match=r"has no table \[servo\]"):
        flexgen.export_ros2(NAME, tmp_path, parts=["position"])
    model = flexgen.read(NAME, overrides={"servo": SERVO})
    with pytest.raises(ArgumentError, match="gains: given with positions"):
        flexgen.export_ros2(model, tmp_path, parts=["position"], gains=gains())
    with pytest.raises(
        ArgumentError, match="parts: given noise, expected some of force, limits, position"
    ):
        flexgen.export_ros2(model, tmp_path, parts=["noise"])
    uneven = flexgen.read(NAME, overrides={"servo": {**SERVO, "sample_time": 7e-4}})
    with pytest.raises(
        ArgumentError,
        match=r"servo\.sample_time of planar5_nmp: given 0\.0007 s, expected a part of",
    ):
        flexgen.export_ros2(uneven, tmp_path, parts=["position"])
    both = flexgen.export_ros2(model, tmp_path / "both", parts=["position", "force"])
    text = (tmp_path / "both" / "config" / "controller.yaml").read_text()
    assert len(both.files) > 15
    assert (
        "wrench_time" in text and "position_gain" not in text and "samples_per_interval: 5" in text
    )


@pytest.mark.slow
@pytest.mark.parametrize("part", [pytest.param("", marks=pytest.mark.full), "force", "position"])
def test_cmake_builds_the_plugin_and_the_controller(package, pushed, served, tmp_path, part):
    """With packages of the same names that have only their targets and functions; the library is
    left out.
    """
    cmake = tool("cmake")
    package = {"": package, "force": pushed[0], "position": served[0]}[part]
    source = tmp_path / "package"
    shutil.copytree(package, source, ignore=shutil.ignore_patterns("*.o", "drive*"))
    (source / "src" / f"{NAME}.c").write_text(f'#include "{NAME}.h"\n', encoding="ascii")
    definitions = {
        "CMAKE_PREFIX_PATH": STUBS / "cmake",
        "STUBS": STUBS,
        "EIGEN": eigen(),
        "CMAKE_CXX_FLAGS": "-O0",
    }
    words = [f"-D{key}={value}" for key, value in definitions.items()]
    run = [
        cmake,
        "-S",
        source,
        "-B",
        tmp_path / "build",
        "-Wno-dev",
        "-DBUILD_TESTING=OFF",
        *words,
    ]
    subprocess.run(run, check=True, capture_output=True)
    subprocess.run([cmake, "--build", tmp_path / "build"], check=True, capture_output=True)
    for name in ("inverse_dynamics", "stream_controller"):
        assert (tmp_path / "build" / f"lib{ROS}_{name}.so").exists()
    calls = (tmp_path / "build" / "ament_calls.txt").read_text().splitlines()
    assert calls == [
        "inverse_dynamics_interface inverse_dynamics_plugin.xml",
        "controller_interface controller_plugin.xml",
        "ament_package",
    ]


def test_an_overlay_has_the_joints_of_its_urdf_file_and_the_ratios(tmp_path):
    """By their names there, whatever these are; motors of two joints keep their own names."""
    yaml = pytest.importorskip("yaml")
    odd = 'panda/joint 1\U0001f916: "a"'
    text = '<robot name="r"><link name="base"/>'
    for name, parent, child in ((odd, "base", "l1"), ("j-2", "l1", "tip")):
        text += f'<link name="{child}"><inertial><origin xyz=".2 0 0"/><mass value="2"/>'
        text += (
            '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        )
        text += f'<joint name={quoteattr(name)} type="continuous"><parent link="{parent}"/>'
        text += f'<child link="{child}"/><origin xyz=".4 0 0"/><axis xyz="0 1 0"/></joint>'
    (tmp_path / "arm.urdf").write_text(f"{text}</robot>", encoding="utf-8")
    overlay = tmp_path / "arm.toml"
    lines = new_model("arm", urdf=str(tmp_path / "arm.urdf"), folder=tmp_path)
    overlay.write_text(lines, encoding="utf-8")

    def parameters(folder):
        flexgen.export_ros2(overlay, folder, gains=None)
        config = yaml.safe_load((folder / "config" / "controller.yaml").read_text())
        return config["stream_controller"]["ros__parameters"]

    found = parameters(tmp_path / "ros2")
    assert (found["joints"], found["gear_ratio"]) == ([odd, "j-2"], [100.0, 100.0])
    sources = (tmp_path / "ros2").rglob("*.[ch]pp")
    assert not any("panda/" in file.read_text(encoding="utf-8") for file in sources)
    first, second = (motor.drives[0] for motor in flexgen.read(overlay).motors)
    lines = re.sub(r"motor = \{ inertia.*", "", lines)
    for name, ratio in (("a", 50), ("b", -50)):
        lines += f'\n[[motor]]\nname = "{name}"\ndrives = ["{first}", "{second}"]\n'
        lines += f"ratio = [100, {ratio}]\ninertia = 1e-4\n"
    overlay.write_text(lines, encoding="utf-8")
    found = parameters(tmp_path / "coupled")
    assert (found["joints"], found["gear_ratio"]) == (["a", "b"], [1.0, 1.0])
