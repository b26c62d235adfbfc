"""`export_ros2`: a ROS 2 package with the library, a plugin of inverse dynamics and a
controller.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Literal

import numpy as np

from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import ArgumentError, BuildError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.spec.ports import CPP_KEYWORDS
from flexgen.base.version import __version__
from flexgen.codegen.build.template_files import template, xml_text, yaml_text
from flexgen.codegen.emission.c_text import quote
from flexgen.dynamics.mechanics.limits import limits_of_model
from flexgen.exports.c_code.emitted import Emitted, ModelLike, emit
from flexgen.exports.c_code.selftest.golden import output_at
from flexgen.exports.exported import Exported
from flexgen.feedback.loop.controllers import Cascade
from flexgen.feedback.loop.gains import propose_gains
from flexgen.model.abilities import obstacle
from flexgen.model.elements import RobotModel
from flexgen.runtime.inversion.limited_inversion import OF_TOOL, SIZES, limit_members

PACKAGE = "flexgen.exports.ros2"
OPEN_GAINS = (
    "the gains in config/controller.yaml are open: the controller refuses to start until they "
    "are set"
)
# relative error of a whole number of samples
PARTS = ("force", "limits", "position")
WHOLE = 1e-6
STEP_TOLERANCE = 0.001  # rad or m, arm side: largest first step of a position
START_TOLERANCE = 0.01  # rad or m, arm side: largest distance from the start of the stream
_NAME = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*\Z")
_EMAIL = re.compile(r"[A-Za-z0-9._%+-]+@[A-Za-z0-9.-]+\Z")
_ROS = ("controller_interface", "hardware_interface", "rclcpp_lifecycle", "std_msgs")
_RESERVED = CPP_KEYWORDS | {"linux", "std", "unix"}  # linux and unix are macros of some compilers
_NEEDED = frozenset(
    {
        *_ROS,
        "controller_manager",
        "geometry_msgs",
        "eigen",
        "inverse_dynamics_interface",
        "pluginlib",
        "rclcpp",
    }
)


@checked_types(own=("model", "directory", "package"))
def export_ros2(
    model: ModelLike,
    directory: str | os.PathLike[str] | None = None,
    *,
    package: str | None = None,
    controller: bool = True,
    gains: Cascade | Literal["proposed", False] | None = "proposed",
    parts: Sequence[str] = (),
    maintainer: str = "maintainer",
    email: str = "maintainer@example.com",
    license_name: str = "MIT",
    force: bool = False,
) -> Exported:
    """Write a ROS 2 package (ament_cmake, C++17, Jazzy or later) around the emitted library.

    It has a plugin of ``inverse_dynamics_interface`` whose torques have the bits of the library,
    and a chainable controller of ``ros2_control``: the samples of a path in, motor torques out, by
    a stream with P-PI control of the motors around it. The controller allocates nothing in its
    updates.

    Parameters
    ----------
    model : str, Path, RobotModel or Equations
    directory : str or Path, optional
        Where to write; default: ``exports/<package>``.
    package : str, optional
        Of the package; default: ``flexgen_<model>``. Small letters, digits and single underscores,
        no word of C++.
    controller : bool
        With the controller. False: the plugin of inverse dynamics only. For models without
        streams.
    gains : Cascade, "proposed", False or None
        Gains for ``config/controller.yaml``, motor side, as of ``flexgen.PPI().cascade(...)``;
        "proposed": those at home; False or None: open, and the controller refuses to start until
        they are set.
    parts : sequence of str
        ``force``: the controller takes a known force on the tool, with the samples and from a
        topic; ``limits``: its stream keeps limits; ``position``: it sends positions to servos,
        table ``[servo]``. Limits by parameters, those of the model but root mean squares;
        positions in place of torques, without gains.
    maintainer : str
        Name for package.xml.
    email : str
        Address for package.xml.
    license_name : str
        License for package.xml.
    force : bool
        Also replace files that were changed since the export.

    Returns
    -------
    Exported

    Raises
    ------
    ModelError, ArgumentError, BuildError
        The model cannot be read, or has no streams; a name is not allowed; the folder holds other
        files.

    Examples
    --------
    >>> print(flexgen.export_ros2("elbow", gains=None, maintainer="Ada", email="ada@example.org"))
    exports/flexgen_elbow
    """
    if set(parts) - set(PARTS) or (parts and not controller):
        raise ArgumentError(
            f"parts: given {', '.join(parts)}, expected some of {', '.join(PARTS)}, and a "
            "controller"
        )
    positions = "position" in parts
    library = emit(model, streams=controller, parts=tuple(dict.fromkeys(parts)))
    name = library.name
    chosen = _package_name(package, name)
    if not _EMAIL.match(email):
        raise ArgumentError(
            f"email: given {email!r}, expected an address such as name@example.com"
        )
    if gains == "proposed":
        gains = propose_gains(library.equations) if controller and not positions else None
    if gains and positions:
        raise ArgumentError(
            "gains: given with positions, expected none; the robot has its own servos"
        )
    if gains and not controller:
        raise ArgumentError(
            "gains: given without a controller, expected none; they are parameters of the "
            "controller"
        )
    words = _words(library, chosen, controller, gains or None, parts)
    words |= {
        "VERSION": __version__,
        "MODEL": name,
        "LIBRARY": name,
        "EMAIL": xml_text(email),
        "MAINTAINER": xml_text(maintainer),
        "LICENSE": xml_text(license_name),
    }
    notes = (OPEN_GAINS,) * (controller and not gains and not positions)
    texts = {f"src/{name}.c": library.source, f"include/{chosen}/{name}.h": library.header}
    sections = (
        *parts,
        *["limited"] * ("limits" in parts),
        *["load"] * any(row["name"] == "loaded_friction" for row in library.functions),
    )
    for file, path in _files(chosen, controller, parts).items():
        texts[path] = _render(file, chosen, name, words, sections)
    return library.write("ros2", directory, texts, force=force, default=chosen, notes=notes)


def _package_name(package: str | None, name: str) -> str:
    """The name of the package, or the default for a library; BuildError for one that is not
    allowed.
    """
    chosen = f"flexgen_{name.lower()}" if package is None else package
    if not isinstance(chosen, str) or not _NAME.match(chosen) or len(chosen) > 60:
        raise BuildError(
            f"package: given {chosen!r}, expected small letters, digits and single underscores, "
            "beginning with a letter; choose it with package= (--package)"
        )
    if chosen in _RESERVED or chosen in _NEEDED:
        reason = "a word of C++" if chosen in _RESERVED else "a package that this one needs"
        raise BuildError(
            f"package: given {chosen!r}, which is {reason}, expected another name, such as "
            f"{chosen + '_dynamics'!r}; choose it with package= (--package)"
        )
    return chosen


def _files(package: str, controller: bool, parts: Sequence[str]) -> dict[str, str]:
    """Path in the package by the name of the template; with ``controller`` also those of the
    stream controller, ``parts``: its options.
    """
    files = {
        "CMakeLists.txt": "CMakeLists.txt",
        "package.xml": "package.xml",
        "README.template.md": "README.md",
        "inverse_dynamics_plugin.xml": "inverse_dynamics_plugin.xml",
        "arm.hpp": f"include/{package}/arm.hpp",
        "inverse_dynamics.hpp": f"include/{package}/inverse_dynamics.hpp",
        "inverse_dynamics.cpp": "src/inverse_dynamics.cpp",
        "test_plugin.cpp": "test/test_plugin.cpp",
    }
    if controller:
        files |= {
            "controller_plugin.xml": "controller_plugin.xml",
            "controller.yaml": "config/controller.yaml",
            "stream_controller.launch.in": "launch/stream_controller.launch.py",
            "stream_controller.cpp": "src/stream_controller.cpp",
        }
        own = "position_window.hpp" if "position" in parts else "cascade.hpp"
        headers = (
            own,
            "sample_queue.hpp",
            "stream_controller.hpp",
            *["force_ramp.hpp"] * ("force" in parts),
        )
        files |= {header: f"include/{package}/{header}" for header in headers}
    return files


def _render(
    file: str, package: str, name: str, words: Mapping[str, str], parts: Sequence[str] = ()
) -> str:
    """A template with the names of the library, of the package and of its namespace.

    The namespace begins with flexgen_, so that a package may be called as a function of C, such as
    div or signal.
    """
    space = package if package.startswith("flexgen_") else f"flexgen_{package}"
    names = {"flexgen_model": package, "FLEXGEN_MODEL": package.upper(), "flexgen_space": space}
    return template(PACKAGE, file, name, words, names, [part.upper() for part in parts])


def _words(
    library: Emitted, package: str, controller: bool, gains: Cascade | None, parts: Sequence[str]
) -> dict[str, str]:
    """The numbers and names of the templates, by their placeholders; those of the controller are
    empty without it. ``parts``: its options.
    """
    model = library.model
    equations = library.equations
    home, zero = np.zeros((2, model.n_a))
    home[list(model.i_g)] = model.home
    torques = evaluate(equations.function("inverse_dynamics"), home, zero, zero)[0][0]
    words = {
        "ACTUATED": ", ".join(str(i) for i in model.i_g),
        "MOTORS": ", ".join(quote(motor.name) for motor in model.motors),
        "HOME_TORQUES": numbers(torques),
        "REFUSED_FRICTION": _refused_friction(model),
        "WRENCH_ROWS": wrench_rows(model) if "force" in parts else "",
        "STREAM": "",
        "DEPENDS": "",
        "CONTROLLER": "",
        "README_CONTROLLER": "",
    }
    if not controller:
        return words
    options = library.stream
    if options is None:
        raise ArgumentError(
            f"model {model.name}: given a home pose at which no stream can start (singular, or "
            "without equilibrium), expected another one; change `home` in the model file, or "
            "leave the controller out: controller=False (--no-controller)"
        )
    tolerance = STEP_TOLERANCE if "position" in parts else START_TOLERANCE
    start = output_at(equations, home)
    tolerance = tolerance * float(np.abs(model.eta).max())
    n = model.n_m
    own = getattr(gains, "torque_max", None)
    largest = [motor.torque_max or 0.0 for motor in model.motors] if own is None else own
    stream = f"""
// Of the stream controller, where its parameters say nothing else: the output at home, the \
largest difference of a
// motor angle from the start of the stream [rad], and the largest torques.
inline constexpr std::array<double, {len(start)}> START_OUTPUT = {{{numbers(start)}}};
inline constexpr double START_TOLERANCE = {tolerance!r};
inline constexpr std::array<double, {n}> TORQUE_MAX = {{{numbers(largest)}}}; // [N m]; 0: no limit
"""
    samples = options.samples_per_interval
    limits = _limits(model) if "limits" in parts else {}
    for key, x in limits.items():  # 0: no limit
        stream += (
            f"inline constexpr std::array<double, {len(x)}> LIMIT_{key.upper()} = "
            f"{{{numbers(x)}}};\n"
        )
    if "position" in parts:
        samples = servo_samples(model, options.period)
        stream += f"inline constexpr int SAMPLES_PER_INTERVAL = {samples}; // as of the servo\n"
    return words | {
        "STREAM": stream,
        "DEPENDS": "".join(
            f"  <depend>{name}</depend>\n"
            for name in (*_ROS, *["geometry_msgs"] * ("force" in parts))
        )
        + "  <exec_depend>controller_manager</exec_depend>\n",
        "CONTROLLER": _render("controller.cmake", package, library.name, {}, parts),
        "README_CONTROLLER": f"- `{package}/StreamController`: a chainable controller of "
        "ros2_control; its parameters are in `config/`,\n"
        "  `launch/` starts it.\n",
        "RATE": str(round(samples / options.period)),
        "JOINTS": ", ".join(yaml_text(name) for name, _ in _hardware(model)),
        "RATIOS": numbers(ratio for _, ratio in _hardware(model)),
        "ZEROS": numbers([0.0] * n),
        "GAINS": _gains_text(gains, n),
        "TORQUE_MAX": numbers(largest),
        "LIMITS": "\n".join(
            f"      {key}: {numbers(x) if key in OF_TOOL else f'[{numbers(x)}]'}"
            for key, x in limits.items()
            if len(x)
        ),
        "START_OUTPUT": numbers(start),
        "START_TOLERANCE": repr(tolerance),
        "PERIOD": repr(options.period),
        "INTERVALS": str(options.intervals),
        "SAMPLES": str(samples),
    }


def _hardware(model: RobotModel) -> list[tuple[str, float]]:
    """Joint of the hardware and its gear ratio for each motor.

    The joints of the URDF file, by their names in it, where each motor drives one of them; else
    the motors themselves.
    """
    out = []
    for motor in model.motors:
        joint = model.urdf_joints.get(motor.drives[0])
        if len(motor.drives) > 1 or joint is None:
            return [(motor.name, 1.0) for motor in model.motors]
        out.append((joint.name, motor.ratio[0]))
    return out


def _limits(model: RobotModel) -> dict[str, np.ndarray]:
    """Limits in the model file, as values of the parameters of the generated controller.

    The controller passes them to the streaming inversion, which computes motor torques from
    samples of the output. The keys are the members of its struct of limits in C. The arrays have
    one number for each motor (n_m,), elastic coordinate (n_e,) or actuated coordinate (n_g,), in
    the units of the model file, or a single one for the tool; 0: no limit. ``torque_speed``: the
    points of the torque-speed curves of all motors, flat; empty: no motor has a curve.
    """
    sizes = {"n_m": model.n_m, "n_e": model.n_e, "n_g": model.n_g}
    out = {member: np.zeros(sizes[size]) for member, size in SIZES.items()}
    out |= {member: np.zeros(1) for member in OF_TOOL}
    given = limits_of_model(model).for_library(model)
    curves = limit_members(
        "limits", {"torque_speed": given.pop("torque_speed", None)}, sizes, np.dtype(float)
    )
    # an infinite limit in the model is 0 in the parameters
    for member, x in given.items():
        out[member] = np.where(np.isfinite(x), x, 0.0).reshape(-1)
    return out | {"torque_speed": curves.get("torque_speed", np.zeros(0)).reshape(-1)}


def servo_samples(model: RobotModel, period: float) -> int:
    """Samples of the servo of a model in an interval of the stream, ``period`` [s]; ArgumentError
    where this is not a whole number.
    """
    assert model.servo is not None
    samples = round(period / model.servo.sample_time)
    if samples < 1 or abs(samples * model.servo.sample_time / period - 1.0) > WHOLE:
        raise ArgumentError(
            f"servo.sample_time of {model.name}: given {model.servo.sample_time} s, expected a "
            f"part of {period} s, an interval of the stream"
        )
    return samples


def wrench_rows(model: RobotModel) -> str:
    """Components of the output among those of a force and a torque on the tool."""
    if model.output.type == "combination":
        raise ArgumentError(
            f"parts: given force for {model.name}, whose output is none of the tool, expected "
            "no parts"
        )
    if model.output.has_angle:
        raise ArgumentError(
            f"parts: given force for {model.name}, whose output is the position and one angle of "
            "the tool, expected no parts"
        )
    axes = model.output.axes if model.output.type == "tool_position" else "xyzabc"
    return ", ".join(str("xyzabc".index(axis)) for axis in axes)


def _refused_friction(model: RobotModel) -> str:
    """A line that refuses a friction for which the interface, which has the velocities alone,
    lacks a number.
    """
    reason = obstacle(model, "velocities of ROS 2")
    if reason is None:
        return ""
    return (
        "\n"
        "    throw "
        f"std::runtime_error({quote(f'friction: given velocities, expected none: {reason}')});"
    )


def _gains_text(gains: Cascade | None, n: int) -> str:
    """The lines of the gains of ``n`` motors in the YAML file: comments where there are none;
    ArgumentError for another controller than a cascade without filters.
    """
    units = {"position_gain": "[1/s]", "speed_gain": "[N m s/rad]", "integral_gain": "[1/s]"}
    if gains is None:
        lines = [
            f"    # {key}: [{', '.join(['...'] * n)}]  # {unit}\n" for key, unit in units.items()
        ]
        return (
            "    # P-PI control; the controller refuses to start until these are set.\n"
            + "".join(lines)
        )
    if not isinstance(gains, Cascade) or len(gains.filters) > 0:
        raise ArgumentError(
            f"gains: given {type(gains).__name__}, expected a Cascade without filters"
        )
    text = "    # P-PI control.\n"
    for key, unit in units.items():
        x = np.asarray(getattr(gains, key), dtype=float)
        if x.shape != (n,) or not np.isfinite(x).all() or (x < 0).any():
            raise ArgumentError(
                f"gains, {key}: given {x}, expected {n} numbers >= 0, one for each motor"
            )
        text += f"    {key}: [{numbers(x)}]  # {unit}\n"
    return text


def numbers(x: Iterable[float]) -> str:
    """Numbers with commas between them, which C++ and YAML read back to the same bits."""
    return ", ".join(re.sub(r"^(-?\d+)(e)", r"\1.0\2", repr(float(value))) for value in x)
