"""The content of an analysis: rows, tables and sentences, see `flexgen.base.rows`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from flexgen.analysis.linear import UNDAMPED
from flexgen.analysis.zero_dynamics.zeros import ON_AXIS
from flexgen.base.display import number, plain, roots
from flexgen.base.rows import Column, Data, Part, Prose, Row, Table
from flexgen.dynamics.dae.structure import to_dict

STANDSTILL = 1e-6
"""Frequency of a rigid-body motion, relative to that of the highest mode: of rounding errors."""

DIGITS = 9
"""Decimals of coordinates and torques at rest that are printed: further ones are rounding."""

ROUNDING = 1e-7
"""Part of a zero that is rounding, relative to its size."""


def content_of_analysis(analysis: Any) -> tuple[Part, ...]:
    """Equilibrium, modes and zeros, verdicts on the inverse dynamics, compliance of the tool."""
    along = analysis.zero_path
    return (
        Prose(f"{analysis.model.title}: analysis of an equilibrium", is_title=True),
        *(Data(key, value) for key, value in entries_of_analysis(analysis).items()),
        *equilibrium_tables(analysis),
        *dynamics_parts(analysis),
        *_rows_of_inversion(analysis),
        *_rows_of_compliance(plain(analysis.compliance and analysis.compliance.to_dict())),
        *(Prose(f"note: {line}", "notes") for line in analysis.solvability.warnings),
        *([] if along is None else [Prose(f"along the path, {along.verdict}")]),
    )


def entries_of_analysis(analysis: Any) -> dict[str, Any]:
    """The entries of JSON, SI units; complex numbers as ``[re, im]``."""
    model = analysis.model
    return {
        "model": model.name,
        "n_m": model.n_m,
        "n_g": model.n_g,
        "n_e": model.n_e,
        "dof": model.dof,
        "pose": analysis.equilibrium.q_a.tolist(),
        "motor_torque_Nm": analysis.equilibrium.tau_m.tolist(),
        "modes_hz": [f for f, _ in analysis.modes],
        "modes_damping": [d for _, d in analysis.modes],
        "poles": _pairs(analysis.poles),
        "zeros": _pairs(analysis.zeros.zeros),
        "zeros_motor": _pairs(analysis.zeros_motor),
        "phase": analysis.zeros.phase,
        "structural_index": analysis.structural_index,
        "unstable_time_constant_s": analysis.zeros.unstable_time_constant_s,
        "preview_s": analysis.zeros.preview_s,
        "structure": to_dict(analysis.structure, analysis.structure_check),
        "kunkel_mehrmann": analysis.kunkel_mehrmann.to_dict(),
        "solvability": analysis.solvability.to_dict(),
        "compliance": None if analysis.compliance is None else analysis.compliance.to_dict(),
        "zeros_along_path": None if analysis.zero_path is None else analysis.zero_path.to_dict(),
        "solvability_along_path": None
        if analysis.solvability_path is None
        else analysis.solvability_path.to_dict(),
    }


def _pairs(values: np.ndarray | None) -> list[list[float]] | None:
    """Complex numbers as ``[re, im]``."""
    return None if values is None else [[float(z.real), float(z.imag)] for z in values]


def equilibrium_tables(analysis: Any) -> tuple[Table, Table]:
    """The coordinates [rad or m] at rest, and the motor torques [N m] that hold them."""
    model = analysis.model
    rest = analysis.equilibrium
    coordinates = tuple(
        (coordinate.name, number(round(float(q), DIGITS) + 0.0), coordinate.unit)
        for coordinate, q in zip(model.coordinates, rest.q_a, strict=True)
    )
    torques = tuple(
        (motor.name, round(float(torque), DIGITS) + 0.0)
        for motor, torque in zip(model.motors, rest.tau_m, strict=True)
    )
    return (
        Table(
            (Column("coordinate"), Column("equilibrium"), Column("unit")),
            coordinates,
            "Equilibrium",
        ),
        Table((Column("motor"), Column("torque", "N m")), torques),
    )


def dynamics_parts(analysis: Any) -> tuple[Part, ...]:
    """Tables of the modes and of the zeros of the output, and the verdict on the zeros."""
    top = max((frequency for frequency, _ in analysis.modes), default=0.0)
    modes = [(f, ratio) for f, ratio in analysis.modes if f > STANDSTILL * top]
    report = analysis.zeros
    zeros = [_without_rounding(z) for z in report.zeros if z.imag >= -1e-9 * abs(z)]
    cells = tuple((k, f, damping_text(ratio)) for k, (f, ratio) in enumerate(modes, 1))
    parts: list[Part] = [
        Table((Column("mode"), Column("frequency", "Hz"), Column("damping ratio")), cells, "Modes")
        if modes
        else Prose("no oscillatory mode")
    ]
    if zeros:
        columns = (Column("zero of the output, 1/s"), Column("stability"))
        sides = tuple((roots([[z.real, z.imag]])[0], _side(z)) for z in zeros)
        parts.append(Table(columns, sides, "Zeros of the output"))
    inner = plain(_pairs(analysis.zeros_motor)) or []
    notches = sorted(
        math.hypot(*root) / (2 * math.pi) for root in inner if None not in root and root[1] > 0
    )
    return (
        *parts,
        Row("phase of the output", report.phase),
        Row("zeros, motor torque to motor angle", ", ".join(map(number, notches)), "Hz"),
        Data("zeros_motor_hz", notches),
        Row(
            "time constant of the slowest unstable zero",
            report.unstable_time_constant_s or None,
            "s",
        ),
        Row("preview required for exact tracking (14 time constants)", report.preview_s, "s"),
    )


def damping_text(ratio: float | None) -> float | str | None:
    """A damping ratio; a bound where it is that of rounding errors."""
    if ratio is None or not math.isfinite(ratio):
        return None
    return ratio if abs(ratio) >= UNDAMPED else f"< {UNDAMPED:g}"


def _without_rounding(zero: complex) -> complex:
    """A zero without a part that is only rounding, against its size."""
    least = ROUNDING * abs(zero)
    real, imaginary = (0.0 if abs(x) < least else x for x in (zero.real, zero.imag))
    return complex(real, imaginary)


def _side(zero: complex) -> str:
    """Stability of a zero as text."""
    if abs(zero.real) <= ON_AXIS * abs(zero):
        return "on the imaginary axis"
    return "unstable" if zero.real > 0 else "stable"


def _rows_of_inversion(analysis: Any) -> tuple[Row, ...]:
    """Index of the inverse dynamics as a DAE, and how well it can be solved."""
    structure = plain(to_dict(analysis.structure, analysis.structure_check))
    ranks = plain(analysis.kunkel_mehrmann.to_dict())
    solvable = plain(analysis.solvability.to_dict())
    rows = [Row("structural index", analysis.structural_index)]
    if structure.get("blocks"):
        sizes = ", ".join(str(len(block["equations"])) for block in structure["blocks"])
        rows.append(Row("equations per block of the DAE", sizes))
        rows.append(Row("structural analysis at this pose", structure["verdict"]))
    if ranks.get("verdict") == "regular":
        found = f"{ranks['mu']}; {ranks['a']}, {ranks['d']}, {ranks['v']}"
        rows.append(Row("strangeness index; a, d, v", found))
        rows.append(Row("singular value gap of the rank decisions", ranks["gap"], "relative"))
    elif ranks:
        rows.append(Row("strangeness index", ranks.get("verdict")))
    if solvable.get("singular_values"):
        smallest = min(solvable["singular_values"])
        rows.append(Row("solvability, smallest singular value", smallest, "relative"))
    if solvable.get("controllability") is not None:
        smallest = solvable["controllability"]
        rows.append(Row("controllability, smallest singular value", smallest, "relative"))
    return tuple(rows)


def _rows_of_compliance(data: dict[str, Any] | None) -> tuple[Row, ...]:
    """The compliance of the tool with held motors; empty where it has none."""
    if data is None or not any(data["principal_m_per_N"]):
        return ()
    along = ", ".join(f"{round(x, 2) + 0.0:.2f}" for x in data["directions"][0])
    moved = _millionths(data["principal_m_per_N"])
    turned = _millionths(data["principal_rad_per_Nm"])
    return (
        Row("compliance of the tool with held motors", moved, "um/N"),
        Row("direction of the largest, in the world", along),
        Row("rotation of the tool with held motors", turned, "urad/(N m)"),
        *_resonance(data),
    )


def _resonance(data: dict[str, Any]) -> tuple[Row, ...]:
    """The largest compliance of all frequencies."""
    if data["resonance_hz"] is None:
        return ()
    label = f"compliance at {number(data['resonance_hz'])} Hz, largest of all frequencies"
    peak = data["resonance_m_per_N"]
    if peak is None:
        return (Row(label, "not bounded: a mode without damping"),)
    return (Row(label, 1e6 * peak, "um/N"),)


def _millionths(values: Sequence[float]) -> str:
    """Values in millionths; those that are zero but for rounding as 0."""
    largest = float(np.abs(values).max())
    return ", ".join(number(1e6 * x) if abs(x) > 1e-9 * largest else "0" for x in values)
