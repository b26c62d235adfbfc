"""`export_simulink`: the emitted library as blocks of Simulink, for C Caller and as
S-functions.
"""

from __future__ import annotations

import os

from flexgen.base.checks.type_checks import checked_types
from flexgen.codegen.build.template_files import template
from flexgen.codegen.emission.c_text import comment
from flexgen.exports.c_code.emitted import Emitted, ModelLike, emit
from flexgen.exports.exported import Exported

PACKAGE = "flexgen.exports.c_code.simulink"


@checked_types(own=("model", "directory"))
def export_simulink(
    model: ModelLike,
    directory: str | os.PathLike[str] | None = None,
    *,
    stream: bool = True,
    force: bool = False,
) -> Exported:
    """Write the emitted library as blocks of Simulink.

    ``<name>_ccaller.h`` has all functions of one point for blocks of type C Caller: plain arrays
    of ``double``, sizes as numbers, the status as an ``int``. ``<name>_stream_sfun.c`` and
    ``<name>_inverse_dynamics_sfun.c`` are level-2 S-functions in C; ``setup_<name>.m`` compiles
    them.

    Parameters
    ----------
    model : str, Path, RobotModel or Equations
    directory : str or Path, optional
        Where to write; default: ``exports/<name>_simulink``.
    stream : bool
        With a stream. False: without a stream, for models that have none.
    force : bool
        Also replace files that were changed since the export.

    Returns
    -------
    Exported

    Raises
    ------
    ModelError, ArgumentError, BuildError
        The model cannot be read or has no streams; the folder holds other files.

    Examples
    --------
    >>> print(flexgen.export_simulink("elbow"))
    exports/elbow_simulink
    """
    library = emit(model, streams=stream)
    name = library.name
    header, source = _ccaller(library)
    blocks = ["inverse_dynamics_sfun.c", *["stream_sfun.c"] * stream]
    texts = library.texts() | {f"{name}_ccaller.h": header, f"{name}_ccaller.c": source}
    texts |= {f"{name}_{block}": template(PACKAGE, block, name) for block in blocks}
    words = {
        "NAME": name,
        "NAMECAPITAL": name.upper(),
        "BLOCKS": ", ".join(f"'{name}_{block}'" for block in blocks),
    }
    texts[f"setup_{name}.m"] = template(PACKAGE, "setup.template.m", name, words)
    return library.write("simulink", directory, texts, force=force)


def _ccaller(library: Emitted) -> tuple[str, str]:
    """Header and source of the functions for C Caller: no typedefs, no structs, no workspace."""
    name = library.name
    NAME = library.name.upper()
    head = comment(
        f"{name}: functions of one point for C Caller blocks of Simulink: arrays of double, "
        f"matrices by columns. They return 0 or a negative status; see {name}.h. Written by "
        "flexgen."
    )
    header = ""
    source = ""
    for f in library.functions:
        sizes = {"const double": f["inputs"], "double": f["outputs"]}
        arguments = ", ".join(
            f"{kind} {p['name']}[{' * '.join(map(str, p['shape']))}]"
            for kind, ports in sizes.items()
            for p in ports
        )
        prototype = f"int {name}_ccaller_{f['name']}({arguments})"
        header += f"/*\n{comment(f['summary'])} */\n{prototype};\n\n"
        words = [p["name"] for p in (*f["inputs"], *f["outputs"])] + ["work"] * f["work"]
        work = f"    double work[{NAME}_WORK];\n" if f["work"] else ""
        source += (
            f"{prototype}\n"
            "{\n"
            f"{work}    return (int){name}_{f['name']}({', '.join(words)});\n"
            "}\n"
            "\n"
        )
    guard = f"{NAME}_CCALLER_H"
    top = f"/*\n{head} */\n"
    return (
        f"{top}#ifndef {guard}\n"
        f"#define {guard}\n"
        f"\n"
        f"#ifdef __cplusplus\n"
        f'extern "C" {{\n'
        f"#endif\n"
        f"\n"
        f"{header}"
        "#ifdef __cplusplus\n}\n#endif\n\n#endif\n",
        f'{top}#include "{name}_ccaller.h"\n#include "{name}.h"\n\n{source.rstrip()}\n',
    )
