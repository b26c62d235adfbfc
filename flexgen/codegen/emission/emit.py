"""The text of the C library: all its files by name; nothing is compiled here.

The text depends on the specification alone: no time stamp, host or path. Names pass the gates of
`ports`; text from a model file is never written.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

from flexgen.base.errors import BuildError
from flexgen.base.spec.ports import c_name_problem, identifier_problem
from flexgen.codegen.emission.clib_files import inversion_files, inversion_header, kernel_files
from flexgen.codegen.emission.entry_points import mathematics, source
from flexgen.codegen.emission.example import example
from flexgen.codegen.emission.facade import facade
from flexgen.codegen.emission.header import batch_header, header
from flexgen.codegen.emission.kinematics_header import kinematics_files, kinematics_header
from flexgen.codegen.emission.spec import FunctionSpec, LibrarySpec
from flexgen.codegen.statements.function_text import FunctionText, function_text

SOURCES = "src"  # folder of the private files

# Names that the emitted functions use in addition to their ports.
_INTERNAL = re.compile(
    r"(t\d+|z\d+|(angle|co?sine)\d+|(left|right|rest|x)\d+|[wnkijFTPdx]|work|status|first|last|"
    r"at|end|count|check|times|inverse|pivot|upper|zero|group|groups|bad|copied|collide|matrix|"
    r"rows|sum|whole|inertia|masses|turning|real|lanes|stride|size|known|thread|\w*_(evaluate|"
    r"step|fill)(_\w+)?|\w*_failed|all_finite|set_nan|at_[a-zA-Z0-9_]*|space)\Z"
)


def function_texts(
    spec: LibrarySpec, log: Callable[[str], None] | None = None
) -> dict[str, FunctionText]:
    """The mathematics of every function as C, by name.

    BuildError where an operation cannot be written. ``log`` gets a line before each function.
    """
    found = {}
    for k, function in enumerate(spec.functions, 1):
        if log is not None:
            log(f"writing function {k} of {len(spec.functions)}: {function.name}")
        found[function.name] = _write(spec, function)
    return found


def emit(spec: LibrarySpec, written: Mapping[str, FunctionText] | None = None) -> dict[str, str]:
    """Write the library down.

    Parameters
    ----------
    spec : LibrarySpec
    written : mapping of str to FunctionText, optional
        What `function_texts` gives, where it is known.

    Returns
    -------
    dict of str to str
        Text by file name: the public ``<name>.h``, ``<name>_batch.h`` and, where the library has
        them, ``<name>_inversion.h`` and ``<name>_inverse_kinematics.h``; ``example.c``; everything
        else in ``src/``.

    Raises
    ------
    BuildError
        Where a name is not fit for C or an operation cannot be written.
    """
    check_names(spec)
    written = function_texts(spec) if written is None else written
    files = {
        f"{spec.name}.h": header(spec, written),
        f"{spec.name}_batch.h": batch_header(spec, written),
    }
    if spec.inverts:
        files[f"{spec.name}_inversion.h"] = inversion_header(spec, written)
    if spec.declared_in("inverse_kinematics"):
        files[f"{spec.name}_inverse_kinematics.h"] = kinematics_header(spec)
    private = {f"{spec.name}.c": facade(spec)} | kernel_files(spec.name, spec.precision)
    for f in spec.functions:
        private[f"{spec.name}_{f.name}.c"] = source(spec, f, written[f.name])
        private[f"{spec.name}_{f.name}_math.h"] = mathematics(spec, f, written[f.name])
    private |= inversion_files(spec, written) | kinematics_files(spec, written)
    for public in list(files):  # so that no compiler needs to be told where they are
        private = {
            name: text.replace(f'"{public}"', f'"../{public}"') for name, text in private.items()
        }
    files |= {f"{SOURCES}/{name}": text for name, text in private.items()}
    files["example.c"] = example(spec, written)
    for name, text in files.items():
        if not text.isascii():
            raise BuildError(f"{name}: given text beyond ASCII, expected ASCII only")
    return files


def _write(spec: LibrarySpec, f: FunctionSpec) -> FunctionText:
    """The C statements of one function, with the run-time parameters as an array where it takes
    them.
    """
    inputs, outputs = ({port.name: port.size for port in ports} for ports in (f.inputs, f.outputs))
    parameters = "parameters" if spec.parameters and "parameters" in inputs else None
    values = [parameter.value for parameter in spec.parameters]
    return function_text(
        f.program,
        inputs,
        outputs,
        parameters,
        spec.precision,
        values,
        f"{f.name}_",
        shared=not spec.per_point,
    )


def symbols(spec: LibrarySpec) -> tuple[str, ...]:
    """Everything that the library exports, sorted."""
    general = [
        "status_text",
        "abi_version",
        "digest",
        "interface",
        "sizeof_real",
        "sizeof_int",
        "work",
    ]
    general += ["batch_work", *spec.sizes]
    if spec.parameters:
        general.append("parameters")
    functions = (
        f"{f.name}{suffix}" for f in spec.functions for suffix in ("", "_batch", "_batch_strided")
    )
    fixed = (function.name for function in spec.c_functions)
    return tuple(sorted(f"{spec.name}_{name}" for name in (*general, *functions, *fixed)))


def check_names(spec: LibrarySpec) -> None:
    """Everything that becomes a name, or part of one, passes the gate; BuildError where it does
    not.
    """
    driven = [name for gears in spec.gears for name, _ in gears]
    in_comments = [*spec.coordinates, *spec.motors, *driven]
    identifiers = [spec.name, *spec.sizes, *(f.name for f in spec.functions)]
    problems = [(name, identifier_problem(name)) for name in in_comments]
    for name, problem in [*problems, *((name, c_name_problem(name)) for name in identifiers)]:
        if problem is not None:
            raise BuildError(f"name for C: given {name!r}, expected {problem}")
    for f in spec.functions:
        for port in (*f.inputs, *f.outputs):
            if _INTERNAL.match(port.name):
                raise BuildError(
                    f"port of {f.name}: given {port.name!r}, which the emitted function uses "
                    "itself"
                )
    exported = symbols(spec)
    if len(set(exported)) != len(exported):
        raise BuildError(
            f"functions of {spec.name}: given names that collide, expected {len(exported)} "
            "different ones"
        )
