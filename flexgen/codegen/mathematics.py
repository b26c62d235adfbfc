"""The mathematics of one function as C: the instructions of an SX function, one constant local per operation.

The operations, their order and their operands are those of CasADi's virtual machine, so that a compiler that does not
contract or reassociate (``-std=c99 -ffp-contract=off``) gives the same bits. Long functions are split into chunks, as
compile time and memory grow faster than length; values that outlive a chunk pass through the caller's workspace.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import casadi as ca

from flexgen.errors import BuildError

CHUNK = 1000  # operations per C function; a compiler's time grows faster than a function's length
MARGIN = 250  # a function that is longer than a chunk by less than this stays in one piece

# What a name in the emitted function may not be: the locals t0, t1, ... and the workspace.
LOCAL, WORKSPACE = "t", "w"

# How CasADi's virtual machine computes each operation, in C.
_OPERATIONS: dict[int, str] = {
    ca.OP_ASSIGN: "{0}",
    ca.OP_LIFT: "{0}",
    ca.OP_ADD: "{0} + {1}",
    ca.OP_SUB: "{0} - {1}",
    ca.OP_MUL: "{0} * {1}",
    ca.OP_DIV: "{0} / {1}",
    ca.OP_NEG: "-{0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "2.0 * {0}",
    ca.OP_INV: "1.0 / {0}",
    ca.OP_LT: "{0} < {1} ? 1.0 : 0.0",
    ca.OP_LE: "{0} <= {1} ? 1.0 : 0.0",
    ca.OP_EQ: "{0} == {1} ? 1.0 : 0.0",
    ca.OP_NE: "{0} != {1} ? 1.0 : 0.0",
    ca.OP_NOT: "{0} == 0.0 ? 1.0 : 0.0",
    ca.OP_AND: "({0} != 0.0 && {1} != 0.0) ? 1.0 : 0.0",
    ca.OP_OR: "({0} != 0.0 || {1} != 0.0) ? 1.0 : 0.0",
    ca.OP_IF_ELSE_ZERO: "{0} != 0.0 ? {1} : 0.0",
    ca.OP_SIGN: "{0} < 0.0 ? -1.0 : {0} > 0.0 ? 1.0 : {0}",
    ca.OP_POW: "pow({0}, {1})",
    ca.OP_CONSTPOW: "pow({0}, {1})",
    **{
        getattr(ca, f"OP_{name.upper()}"): f"{name}({{0}})"
        for name in (
            "sqrt exp log expm1 log1p erf floor ceil fabs sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh"
        ).split()
    },
    **{
        getattr(ca, f"OP_{name.upper()}"): f"{name}({{0}}, {{1}})"
        for name in "fmin fmax fmod remainder copysign atan2 hypot".split()
    },
}


@dataclass(frozen=True)
class Mathematics:
    """The text of the static C functions and what the caller needs to know of them.

    Parameters
    ----------
    text : str
        Definitions of static functions.
    call : tuple of str
        Statements that evaluate the function, given the ports' arrays and, where ``work`` > 0, the array ``work``.
    work : int
        Doubles of workspace.
    operations : int
        Arithmetic operations and function calls per evaluation.
    """

    text: str
    call: tuple[str, ...]
    work: int
    operations: int


@dataclass(frozen=True)
class _Value:
    """A single-assignment value: its C expression and the values and input arrays it uses."""

    expression: str
    uses: tuple[int, ...]
    array: int | None = None  # an input's index where the value is one of its entries


@dataclass(frozen=True)
class _Store:
    """An entry of an output array: where, and the operand that goes there."""

    output: int
    entry: int
    operand: str
    uses: tuple[int, ...]


def literal(x: float) -> str:
    """A double as the shortest C expression that reads back to the same bits."""
    if math.isnan(x):
        return "NAN"
    if math.isinf(x):
        return "INFINITY" if x > 0 else "(-INFINITY)"
    text = repr(float(x))  # always with a point or an exponent
    return f"({text})" if text.startswith("-") else text


def mathematics(function: ca.Function) -> Mathematics:
    """C text of an SX function with dense arguments; BuildError names an operation that cannot be written."""
    values, steps = _single_assignment(function)
    inputs, outputs = function.name_in(), function.name_out()
    operations = sum(1 for step in steps if isinstance(step, int) and values[step].array is None)
    length = len(steps)
    if length <= CHUNK + MARGIN:
        pieces = [steps]
    else:
        count = math.ceil(length / CHUNK)
        pieces = [steps[length * k // count : length * (k + 1) // count] for k in range(count)]
    slots, work = _slots(values, pieces)
    texts, calls = [], []
    for k, piece in enumerate(pieces):
        name = "evaluate" if len(pieces) == 1 else f"evaluate_{k + 1}"
        text, call = _piece(name, piece, values, slots, inputs, outputs)
        texts.append(text if len(pieces) == 1 else "SEPARATE " + text)
        calls.append(call)
    if len(pieces) > 1:
        texts.insert(0, _SEPARATE)
    return Mathematics("\n".join(texts), tuple(calls), work, operations)


_SEPARATE = """\
#if defined(__GNUC__)
#define SEPARATE __attribute__((noinline))
#else
#define SEPARATE
#endif
"""


def _single_assignment(function: ca.Function) -> tuple[list[_Value], list[int | _Store]]:
    """The function's instructions as values (by number) and the order of values and stores; constants become text."""
    names = function.name_in()
    values: list[_Value] = []
    steps: list[int | _Store] = []
    register: dict[int, tuple[str, tuple[int, ...]]] = {}  # content of each work register: operand, values it uses
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        if operation == ca.OP_CONST:
            register[function.instruction_output(k)[0]] = (literal(function.instruction_constant(k)), ())
            continue
        source = function.instruction_input(k)
        target = function.instruction_output(k)
        if operation == ca.OP_OUTPUT:
            operand, uses = register[source[0]]
            steps.append(_Store(target[0], target[1], operand, uses))
            continue
        if operation == ca.OP_INPUT:
            i, entry = source
            value = _Value(f"{names[i]}[{entry}]", (), i)
        elif operation in _OPERATIONS:
            operands = [register[r] for r in source]
            uses = tuple(dict.fromkeys(u for _, us in operands for u in us))
            value = _Value(_OPERATIONS[operation].format(*(text for text, _ in operands)), uses)
        else:
            raise BuildError(f"function {function.name()}: {_operation_name(operation)} cannot be written in C")
        register[target[0]] = (f"{LOCAL}{len(values)}", (len(values),))
        steps.append(len(values))
        values.append(value)
    return values, steps


def _operation_name(operation: int) -> str:
    """Name of an operation in CasADi's table, such as ``OP_ERFINV``."""
    names = [name for name in dir(ca) if name.startswith("OP_") and getattr(ca, name) == operation]
    return f"operation {names[0] if names else operation}"


def _uses(step: int | _Store, values: list[_Value]) -> tuple[int, ...]:
    return step.uses if isinstance(step, _Store) else values[step].uses


def _slots(values: list[_Value], pieces: list[list[int | _Store]]) -> tuple[dict[int, int], int]:
    """Place in the workspace of every value that outlives its piece, and the number of places.

    Inputs are read again instead. A place is free for another value from the piece after the last use on.
    """
    born: dict[int, int] = {}
    last: dict[int, int] = {}
    for k, piece in enumerate(pieces):
        for step in piece:
            if isinstance(step, int):
                born[step] = k
            for value in _uses(step, values):
                last[value] = k
    slots: dict[int, int] = {}
    free: list[int] = []
    ending: dict[int, list[int]] = {}
    count = 0
    for k, piece in enumerate(pieces):
        for step in piece:
            if not isinstance(step, int) or values[step].array is not None or last.get(step, k) == born[step]:
                continue
            if not free:
                free.append(count)
                count += 1
            slots[step] = free.pop()
            ending.setdefault(last[step], []).append(slots[step])
        free.extend(reversed(ending.get(k, [])))
    return slots, count


def _piece(
    name: str,
    piece: list[int | _Store],
    values: list[_Value],
    slots: dict[int, int],
    inputs: Iterable[str],
    outputs: Iterable[str],
) -> tuple[str, str]:
    """One static function, and the statement that calls it."""
    inputs, outputs = list(inputs), list(outputs)
    own = {step for step in piece if isinstance(step, int)}
    used = {value for step in piece for value in _uses(step, values)}
    lines: list[str] = []
    known: set[int] = set()
    read: set[int] = set()
    written: set[int] = set()
    workspace = False
    for step in piece:
        for value in _uses(step, values):
            if value not in own and value not in known:  # from an earlier piece
                known.add(value)
                array = values[value].array
                if array is None:
                    workspace = True
                    lines.append(f"const double {LOCAL}{value} = {WORKSPACE}[{slots[value]}];")
                else:
                    read.add(array)
                    lines.append(f"const double {LOCAL}{value} = {values[value].expression};")
        if isinstance(step, _Store):
            written.add(step.output)
            lines.append(f"{outputs[step.output]}[{step.entry}] = {step.operand};")
            continue
        if step not in used and step not in slots:
            continue  # an input that a later piece reads again
        array = values[step].array
        if array is not None:
            read.add(array)
        lines.append(f"const double {LOCAL}{step} = {values[step].expression};")
        if step in slots:
            workspace = True
            lines.append(f"{WORKSPACE}[{slots[step]}] = {LOCAL}{step};")
    parameters = [f"const double *{inputs[i]}" for i in sorted(read)]
    parameters += [f"double *{outputs[i]}" for i in sorted(written)]
    arguments = [inputs[i] for i in sorted(read)] + [outputs[i] for i in sorted(written)]
    if workspace:
        parameters.append(f"double *{WORKSPACE}")
        arguments.append("work")
    body = "".join(f"    {line}\n" for line in lines)
    return (
        f"static void {name}({', '.join(parameters) or 'void'})\n{{\n{body}}}\n",
        f"{name}({', '.join(arguments)});",
    )
