"""A block: the content of an FMU in addition to the fixed C files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from flexgen.exports.fmu.variables import (
    INPUT,
    OUTPUT,
    PARAMETER,
    SETTING,
    STATE,
    STATUS,
    TIME,
    Variable,
)

FASTEST = "MODEL_FASTEST(x, u, p, r, w)"  # of the plant, where it has torques with states


@dataclass(frozen=True)
class Block:
    """The mathematics of an FMU and its variables.

    Parameters
    ----------
    name : str
        Model identifier of FMI: an identifier in C.
    title, text : str
        Name and description of the model for people.
    macro : str
        What flexgen_fmu_config.h defines for the kind of block, such as ``FMU_PLANT``.
    variables : tuple of Variable
        All, in the order of modelDescription.xml.
    sources : mapping of str to str
        C files of the model part, by name. The header is included, the others are compiled.
    header : str
        The one to include; empty: none.
    defines : mapping of str to str
        More macros of flexgen_fmu_config.h: numbers and calls of functions of the model.
    constants : mapping of str to sequence of float
        More arrays of flexgen_fmu_config.h.
    sample_time : float
        Of a sampled block [s]; 0: not sampled.
    step : float
        Recommended communication step [s].
    memory, work : str
        Sizes of the block's memory and workspace in C, in numbers.
    derivatives : bool
        Whether it has directional derivatives.
    straight : bool
        Whether its C is mathematics straight on, which compilers need not optimize much.
    """

    name: str
    title: str
    text: str
    macro: str
    variables: tuple[Variable, ...]
    sources: Mapping[str, str]
    header: str
    defines: Mapping[str, str]
    constants: Mapping[str, Sequence[float]]
    sample_time: float
    step: float
    memory: str
    work: str
    derivatives: bool
    straight: bool = False

    def of(self, *kinds: int) -> list[Variable]:
        """The variables of some kinds."""
        return [v for v in self.variables if v.kind in kinds]


def time_variable() -> Variable:
    """The independent variable."""
    return Variable("time", TIME, 0, "s", "simulation time")


def config(block: Block, token: str) -> str:
    """The file flexgen_fmu_config.h: sizes, start values, functions of the model and the ``token``
    of the FMU; no names of variables.
    """
    lines = [
        "/* Sizes, start values and functions of the model. Written by flexgen. */",
        "#ifndef FLEXGEN_FMU_CONFIG_H",
    ]
    lines += ["#define FLEXGEN_FMU_CONFIG_H", "", "#include <stdint.h>", ""]
    lines += [f'#include "{block.header}"', ""] * bool(block.header)
    lines += [
        f"#define {block.macro} 1",
        f'#define TOKEN "{token}"',
        f"#define SAMPLE_TIME {block.sample_time!r}",
    ]
    lines += [f"#define {name} {value}" for name, value in block.defines.items()]
    counts = {
        "N_X": STATE,
        "N_U": INPUT,
        "N_Y": OUTPUT,
        "N_P": PARAMETER,
        "N_SETTINGS": SETTING,
        "HAS_STATUS": STATUS,
    }
    sizes = [f"{name} = {len(block.of(kind))}" for name, kind in counts.items()]
    lines += [
        "",
        f"enum {{ {', '.join(sizes)} }};",
        f"enum {{ N_MEMORY = {block.memory}, N_WORK = {block.work} }};",
        "",
    ]
    starts = {
        "X_START": STATE,
        "U_START": INPUT,
        "Y_START": OUTPUT,
        "P_START": PARAMETER,
        "SETTING_START": SETTING,
    }
    for name, kind in starts.items():
        lines.append(c_array(name, [v.start or 0 for v in block.of(kind)], whole=kind == SETTING))
    lines.append(c_array("X_NOMINAL", [v.nominal or 1.0 for v in block.of(STATE)]))
    lines += [
        c_array(name, values, whole=name.startswith("SETTING"))
        for name, values in block.constants.items()
    ]
    return "\n".join([*lines, "", "#endif", ""])


def c_array(name: str, values: Sequence[float], whole: bool = False) -> str:
    """A constant array in C, of int32_t if ``whole``, else of double; one zero where there are no
    values.
    """
    written = [str(int(x)) if whole else repr(float(x)) for x in values] or ["0"]
    rows = [", ".join(written[k : k + 5]) for k in range(0, len(written), 5)]
    inner = ",\n    ".join(rows)
    return (
        f"static const {'int32_t' if whole else 'double'} {name}[{len(written)}] = {{\n"
        f"    {inner}}};"
    )
