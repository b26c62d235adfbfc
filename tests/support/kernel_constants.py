"""The constants of the kernel, read from the C files that define them."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from flexgen.codegen.emission.clib_files import read_clib

ERRORS = {"sincos": 1.0, "exp": 1.0, "tanh": 3.0}  # units in the last place, as kernel.h states
_NUMBER = r"-?\d+\.\d+(?:e[-+]?\d+)?|-?\d+e[-+]?\d+"


@dataclass(frozen=True)
class Precision:
    """Constants of one precision; polynomials from the constant term on."""

    digits: int
    half_pi: tuple[float, ...]
    log_2: tuple[float, ...]
    angle: float
    lowest: float
    sine: tuple[float, ...]
    cosine: tuple[float, ...]
    exponential: tuple[float, ...]


def read(precision: str) -> Precision:
    text = read_clib()[f"precision_{precision}.h"].replace("\\\n", " ")
    kind = {"double": np.float64, "single": np.float32}[precision]
    macros = dict(re.findall(r"#define (\w+)(?:\([^)]*\))? ([^\n/]*)", text))

    def numbers(name: str) -> tuple[float, ...]:
        return tuple(float(kind(x)) for x in re.findall(_NUMBER, macros[name]))

    def parts(name: str) -> tuple[float, ...]:
        return tuple(numbers(key)[0] for key in sorted(macros) if re.fullmatch(rf"{name}_\d", key))

    (angle,) = numbers("ANGLE_MAX")
    (lowest,) = numbers("LOWEST")
    polynomials = (numbers(name) for name in ("SINE", "COSINE", "EXPONENTIAL"))
    return Precision(
        int(macros["DIGITS"]), parts("HALF_PI"), parts("LOG_2"), angle, lowest, *polynomials
    )


PRECISIONS = {precision: read(precision) for precision in ("double", "single")}
