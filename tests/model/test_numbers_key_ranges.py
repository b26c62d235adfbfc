"""Ranges and defaults of all keys of model files, as editors and the reader have them.

A smaller range refuses files that were read before, and another default changes robots whose file
leaves a key out. The keys are those of `flexgen.model.format.format`,
`flexgen.model.format.format_robot`, `flexgen.model.format.format_devices`,
`flexgen.model.format.format_tasks`, `flexgen.model.format.format_programs`,
`flexgen.base.spec.fourier`, `flexgen.model.position_servo.keys`, `flexgen.base.spec.keys`. A
number behind a name is how often it is a key of tables.
"""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from typing import Any

import flexgen

WORDS = ("minimum", "exclusiveMinimum", "maximum", "exclusiveMaximum", "minItems", "maxItems")
Names = dict[str, Counter[str]]
RANGES = {
    "exclusiveMinimum 0, maximum 1e+12": (
        "acceleration_max:8 break_at:4 coulomb deflection_max:7 duration:12 frequency_hz:4 high:4 "
        "joint_profile_deg:2 joint_profile_rad:2 length lost_motion low:4 mass_per_length "
        "profile:14 radius:10 sample_s:7 smooth:2 smoothing:2 speed:6 speed_deg:2 speed_max:10 "
        "speed_rad:2 static stiffness:8 stribeck_speed thermal_time:2 torque_max:4 "
        "torque_rate_max:2 torque_rms_max:4 zone:2"
    ),
    "minItems 0": (
        "after before branches common dof drop lock low_pass:2 move:2 notch:2 parameters "
        "program:2 remove unfinished"
    ),
    "minItems 1": "bending drives element joints legs:2 motor rows step:2",
    "minItems 1, maxItems 3": "axes:3",
    "minItems 1, maxItems 6": "cos sin",
    "minItems 1, maxItems 64": "cos:4 harmonics:4 sensor sin:4",
    "minItems 1, maxItems 8": "hysteresis",
    "minItems 2": "torque_speed:2",
    "minItems 2, maxItems 2": "torque_speed:2",
    "minItems 2, maxItems 8": "joint_profile_deg:2 joint_profile_rad:2 profile:14",
    "minItems 3, maxItems 3": (
        "axes:3 axis:10 center:2 com:2 configuration:8 displacement:8 gravity inertia:2 "
        "position:13 rotation_axis rotation_deg:10 rotation_rad:10 rpy_deg:10 rpy_rad:10 via:4"
    ),
    "minItems 6, maxItems 6": "inertia:2 turns:4",
    "minItems 9, maxItems 9": "rotation:2",
    "minimum -1, maximum 0.5": "gamma",
    "minimum -100, maximum 100": "turns:4",
    "minimum -100, maximum 300": "temperature",
    "minimum -1e+12, maximum 1e+12": (
        "angle_deg:2 angle_rad:2 axis:10 center:2 com:2 correlation cos:5 damping:2 "
        "displacement:10 end_deg:4 end_rad:4 gauge gravity home_deg home_rad inertia:2 "
        "integral_gain lock lower:4 lower_deg:4 lower_rad:4 mimic:2 offset:3 pole_damping:2 "
        "position:13 position_gain ratio:4 reference_temperature rotation:2 rotation_axis "
        "rotation_deg:10 rotation_rad:10 rows rpy_deg:10 rpy_rad:10 sd sin:5 speed_gain "
        "start_deg:14 start_rad:14 stribeck_slope stribeck_speed_slope temperature_rise upper:4 "
        "upper_deg:4 upper_rad:4 via:4 zero_damping:2"
    ),
    "minimum 0, maximum 1": "delay:2 reference_filter_s:2 viscous_share",
    "minimum 0, maximum 100000": "integral_hz",
    "minimum 0, maximum 1e+12": (
        "alpha:2 beta:2 coulomb:2 cubic:2 damping:5 damping_ratio delay delay_s:7 gap:2 "
        "inertia:2 load_alpha load_coulomb load_smoothing load_stribeck mass:2 moment_noise "
        "noise:7 pause:6 payload rotational_drag stiffness stribeck:2 viscous:2 viscous_decay "
        "zone:4 zone_deg:2 zone_rad:2"
    ),
    "minimum 0, maximum 2": "speed_feedforward:2",
    "minimum 0, maximum 5": "damping friction lost_motion masses motor_inertia stiffness",
    "minimum 1, maximum 1000": "harmonics:4",
    "minimum 1, maximum 20": "exponent",
    "minimum 1, maximum 8": "modes",
    "minimum 1e-06, maximum 1": "sample_time:2",
    "minimum 1e-06, maximum 100000": "position_hz speed_hz",
    "minimum 3, maximum 9": "smoothness:14",
}
DEFAULTS = {
    '"simplified"': "motor_coupling",
    '"tool"': "element",
    '"x"': "reference",
    '"xyz"': "axes:2",
    "0": "smoothness:2",
    "0.0": (
        "alpha:2 beta:2 coulomb:2 damping:6 damping_ratio delay:3 delay_s:7 friction gamma "
        "load_alpha load_coulomb load_smoothing load_stribeck lost_motion masses moment_noise "
        "motor_inertia noise:7 offset:3 pause:6 payload reference_filter_s:2 rotational_drag "
        "smooth:2 stiffness stribeck:2 stribeck_slope stribeck_speed_slope temperature_rise "
        "viscous:2 viscous_decay viscous_share zone:4 zone_deg:2 zone_rad:2"
    ),
    "0.0005": "sample_time:2",
    "0.1": "zero_damping:2",
    "0.25": "radius:10",
    "0.7": "damping:2 pole_damping:2",
    "1.0": "exponent speed_feedforward:2",
    "20.0": "reference_temperature temperature",
    "7": "degree:2",
    "false": "inertia_reduced:3",
    "true": "dynamics limits:2",
}


def _collect(name: str, node: Any, ranges: Names, defaults: Names) -> None:
    """Names of keys by range and by default, of a schema and all that is in it."""
    if isinstance(node, list):
        for inner in node:
            _collect(name, inner, ranges, defaults)
    if not isinstance(node, dict):
        return
    if any(word in node for word in WORDS):
        ranges[", ".join(f"{word} {node[word]:g}" for word in WORDS if word in node)][name] += 1
    if not isinstance(node.get("default", {}), dict):
        defaults[json.dumps(node["default"])][name] += 1
    for key, inner in node.items():
        if key in ("properties", "definitions"):
            for own, each in inner.items():
                _collect(own, each, ranges, defaults)
        elif key not in ("default", "examples"):
            _collect(name, inner, ranges, defaults)


def _shown(names: Names) -> dict[str, str]:
    def text(found: Counter[str]) -> str:
        return " ".join(name if k == 1 else f"{name}:{k}" for name, k in sorted(found.items()))

    return {key: text(found) for key, found in names.items()}


def test_ranges_and_defaults_of_keys_are_what_they_were() -> None:
    ranges: Names = defaultdict(Counter)
    defaults: Names = defaultdict(Counter)
    for kind in ("model", "program"):
        _collect("", flexgen.schema(kind), ranges, defaults)
    assert _shown(ranges) == RANGES
    assert _shown(defaults) == DEFAULTS
