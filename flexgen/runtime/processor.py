"""Instruction sets: what a library was compiled for, and what the processor of this computer
has.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import cache
from pathlib import Path

# Macros that compilers for x86-64 predefine for a set of vector instructions, and its name in
# /proc/cpuinfo.
INSTRUCTION_SETS = {
    "__SSE3__": "pni",
    "__SSSE3__": "ssse3",
    "__SSE4_1__": "sse4_1",
    "__SSE4_2__": "sse4_2",
    "__AVX__": "avx",
    "__F16C__": "f16c",
    "__FMA__": "fma",
    "__AVX2__": "avx2",
    "__BMI__": "bmi1",
    "__BMI2__": "bmi2",
    "__AVX512F__": "avx512f",
    "__AVX512CD__": "avx512cd",
    "__AVX512BW__": "avx512bw",
    "__AVX512DQ__": "avx512dq",
    "__AVX512VL__": "avx512vl",
}


@cache
def instruction_sets() -> frozenset[str] | None:
    """Names of the vector instruction sets of this processor; None where the system does not list
    them.
    """
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None
    flags = re.search(r"^flags\s*:(.*)$", text, re.MULTILINE)
    return (
        None
        if flags is None
        else frozenset(flags[1].split()) & frozenset(INSTRUCTION_SETS.values())
    )


def missing_instruction_sets(needed: Iterable[str]) -> list[str]:
    """Those of ``needed`` that this processor does not have; none where the system does not list
    them.
    """
    present = instruction_sets()
    return [] if present is None else sorted(set(needed) - present)
