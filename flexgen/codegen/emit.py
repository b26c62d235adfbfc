"""The text of the C library: all its files by name; nothing is compiled here.

The text depends on the specification alone: no time stamp, host or path. Names come from `ports.identifier_problem`'s
gate; text from a model file is never written.
"""

from __future__ import annotations

import re

from flexgen.codegen.clib_files import core_texts
from flexgen.codegen.function_files import body, example, facade, meanings, private_header, source
from flexgen.codegen.header import header
from flexgen.codegen.kernel import kernel
from flexgen.codegen.spec import FunctionSpec, LibrarySpec
from flexgen.errors import BuildError
from flexgen.expressions.function_text import FunctionText, function_text
from flexgen.ports import identifier_problem

# Names that the emitted functions use beside their ports.
_INTERNAL = re.compile(
    r"(t\d+|z\d+|(angle|co?sine)\d+|[wnkijFTPdx]|work|status|first|count|inverse|pivot|factor|zero|group|groups|bad|copied|collide|matrix|rows|sum|whole|"
    r"real|lanes|stride|size|known|thread|evaluate(_\d+)*|solve_\d+|all_finite|spoil|failed|at_[a-zA-Z0-9_]*|space)\Z"
)


def emit(spec: LibrarySpec) -> dict[str, str]:
    """Write the library down.

    Parameters
    ----------
    spec : LibrarySpec

    Returns
    -------
    dict of str to str
        Text by file name: ``<name>.h``, ``<name>.c``, ``<name>_<function>.c``, ``example.c``, and the private
        ``<name>_kernel.h``, ``<name>_private.h``, ``<name>_point.h``, ``<name>_lanes.h``, ``<name>_<function>_body.h``;
        where the model inverts, ``<name>_invert.c`` and others, see `flexgen.codegen.clib_files`.

    Raises
    ------
    BuildError
        Where a name is not fit for C or an operation cannot be written.
    """
    check_names(spec)
    written = {f.name: _written(spec, f) for f in spec.functions}
    files = {f"{spec.name}.h": header(spec, written), f"{spec.name}.c": facade(spec, written)}
    files[f"{spec.name}_kernel.h"] = kernel(spec.name, spec.precision)
    files[f"{spec.name}_private.h"] = private_header(spec)
    files |= meanings(spec)
    for f in spec.functions:
        files[f"{spec.name}_{f.name}.c"] = source(spec, f, written[f.name])
        files[f"{spec.name}_{f.name}_body.h"] = body(spec, f, written[f.name])
    files |= core_texts(spec)
    files["example.c"] = example(spec)
    for name, text in files.items():
        if not text.isascii():
            raise BuildError(f"{name}: given text beyond ASCII, expected ASCII only")
    return files


def _written(spec: LibrarySpec, f: FunctionSpec) -> FunctionText:
    inputs, outputs = ({port.name: port.size for port in ports} for ports in (f.inputs, f.outputs))
    parameters = "parameters" if spec.parameters and "parameters" in inputs else None
    values = [parameter.value for parameter in spec.parameters]
    return function_text(f.program, inputs, outputs, parameters, spec.precision, values)


def symbols(spec: LibrarySpec) -> tuple[str, ...]:
    """Everything that the library exports, sorted."""
    general = ["status_text", "abi_version", "digest", "interface", "sizeof_real", "sizeof_int", *spec.sizes]
    if spec.parameters:
        general.append("parameters")
    functions = (f"{f.name}{suffix}" for f in spec.functions for suffix in ("", "_batch", "_work", "_batch_work"))
    cores = (core.name for core in spec.cores)
    return tuple(sorted(f"{spec.name}_{name}" for name in (*general, *functions, *cores)))


def check_names(spec: LibrarySpec) -> None:
    """Everything that becomes a name, or part of one, passes the gate; BuildError where it does not."""
    driven = [name for gears in spec.gears for name, _ in gears]
    names = [spec.name, *spec.coordinates, *spec.motors, *spec.sizes, *driven]
    names += [f.name for f in spec.functions]
    for name in names:
        problem = identifier_problem(name)
        if problem is not None:
            raise BuildError(f"name for C: given {name!r}, expected {problem}")
    for f in spec.functions:
        for port in (*f.inputs, *f.outputs):
            if _INTERNAL.match(port.name):
                raise BuildError(f"port of {f.name}: given {port.name!r}, which the emitted function uses itself")
    exported = symbols(spec)
    if len(set(exported)) != len(exported):
        raise BuildError(f"functions of {spec.name}: given names that collide, expected {len(exported)} different ones")
