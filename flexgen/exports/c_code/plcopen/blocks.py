"""The function blocks: their variables, once, from which the ST, the XML and the struct in C are
written.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from flexgen.base.errors import ArgumentError
from flexgen.exports.c_code.emitted import Emitted

C_TYPES = {"BOOL": "uint8_t", "DINT": "int32_t", "LREAL": "double"}
SECTIONS = ("VAR_INPUT", "VAR_OUTPUT", "VAR")


@dataclass(frozen=True)
class Variable:
    """A variable of a function block: ``size`` 0 for a scalar; ``doc`` with its unit."""

    name: str
    type: str
    size: int
    doc: str


@dataclass(frozen=True)
class Block:
    """A function block.

    Parameters
    ----------
    name : str
        Of the block; ``name`` in small letters is that of its struct and of its function in C.
    doc : str
    inputs, outputs, memory : tuple of Variable
        In the order of the struct.
    """

    name: str
    doc: str
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    memory: tuple[Variable, ...]

    @property
    def sections(self) -> tuple[tuple[str, tuple[Variable, ...]], ...]:
        """Keyword and variables of each section that has any."""
        given = zip(SECTIONS, (self.inputs, self.outputs, self.memory), strict=True)
        return tuple((keyword, variables) for keyword, variables in given if variables)


_RESULT = (
    Variable("valid", "BOOL", 0, "the outputs are those of this call"),
    Variable("error", "BOOL", 0, "the call failed; the other outputs are those before"),
    Variable(
        "status",
        "DINT",
        0,
        "0: success, negative: failed, positive: with a warning; see the header of the library",
    ),
)


def blocks(library: Emitted, stream: bool) -> tuple[Block, ...]:
    """The blocks of a library: inverse dynamics of the arm and, where asked for, a stream."""
    (function,) = (f for f in library.functions if f["name"] == "inverse_dynamics")
    prefix = f"FB_{library.name}"
    ports = {
        p["name"]: Variable(p["name"], "LREAL", p["shape"][0], f"[{p['unit']}] {p['doc']}")
        for p in (*function["inputs"], *function["outputs"])
    }
    inputs = tuple(ports[p["name"]] for p in function["inputs"])
    outputs = tuple(ports[p["name"]] for p in function["outputs"])
    dynamics = Block(
        f"{prefix}_inverse_dynamics", function["summary"], inputs, (*outputs, *_RESULT), ()
    )
    return (dynamics, _stream(library, prefix)) if stream else (dynamics,)


def _stream(library: Emitted, prefix: str) -> Block:
    """The function block of the stream, with its memory as a variable; ``prefix``: of its name.
    ArgumentError where no stream can start at the home pose.
    """
    options = library.stream
    sizes = library.sizes
    if options is None:
        raise ArgumentError(
            f"model {library.model.name}: given a home pose at which no stream can start "
            "(singular, or without equilibrium), expected another one; change `home` in the "
            "model file, or leave the stream out: stream=False (--no-stream)"
        )
    n = sizes["n_m"] * options.samples_per_interval
    inputs = (
        Variable(
            "enable",
            "BOOL",
            0,
            "FALSE: the stream is not active; it starts at start_output when it becomes TRUE",
        ),
        Variable(
            "start_output",
            "LREAL",
            sizes["n_t"],
            "the output at which the robot rests when the stream starts",
        ),
        Variable("q_start", "LREAL", sizes["n_a"], "initial guess of the equilibrium there"),
        Variable(
            "y",
            "LREAL",
            sizes["n_t"],
            "output at the end of the horizon; of a pose position, then matrix by columns",
        ),
        Variable("dy", "LREAL", sizes["n_y"], "its first time derivative"),
        Variable("ddy", "LREAL", sizes["n_y"], "its second time derivative"),
    )
    results = (
        Variable(
            "tau_m",
            "LREAL",
            n,
            "[N m] motor torques of the interval that begins now, sample after sample",
        ),
        Variable("q_m", "LREAL", n, "[rad] motor angles"),
        Variable("v_m", "LREAL", n, "[rad/s] motor speeds"),
    )
    size = stream_size(library, options.intervals, options.samples_per_interval)
    memory = (
        Variable("memory", "LREAL", size, "of the stream"),
        Variable("started", "DINT", 0, "1: the stream is active, -1: it has failed"),
    )
    doc = (
        f"Inverse dynamics of {library.name} on a moving horizon of {options.intervals} "
        f"intervals. Call it every {options.period!r} s with the next sample of the path; the "
        f"output reaches it {options.intervals} calls later. A sample that is refused changes "
        "nothing; after another failure set enable to FALSE once."
    )
    return Block(f"{prefix}_stream", doc, inputs, (*results, *_RESULT), memory)


def stream_size(library: Emitted, intervals: int, samples: int) -> int:
    """Numbers of the memory of a stream: the macro of the header, evaluated."""
    pattern = (
        rf"#define {library.name.upper()}_STREAM_SIZE\(intervals, samples_per_interval\) \\\n"
        r"    \(INT64_C\((\d+)\) \+ INT64_C\((\d+)\) \* \(intervals\) \+ INT64_C\((\d+)\) \* "
        r"\(samples_per_interval\)\)"
    )
    found = re.search(pattern, library.header)
    assert found is not None, "STREAM_SIZE"
    constant, per_interval, per_sample = (int(x) for x in found.groups())
    return constant + per_interval * intervals + per_sample * samples


def struct(block: Block) -> str:
    """The struct of a block in C: its variables in their order."""
    text = "typedef struct {\n"
    for keyword, variables in block.sections:
        text += f"    /* {keyword} */\n"
        for v in variables:
            text += f"    {C_TYPES[v.type]} {v.name}{f'[{v.size}]' if v.size else ''};\n"
    return f"{text}}} {block.name.lower()};\n"
