"""`export_plcopen`: function blocks of IEC 61131-3 with their bodies in C."""

from __future__ import annotations

import os
import re

from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import BuildError
from flexgen.codegen.build.template_files import template
from flexgen.codegen.emission.c_text import comment
from flexgen.exports.c_code.emitted import Emitted, ModelLike, emit
from flexgen.exports.c_code.plcopen.blocks import Block, blocks, struct
from flexgen.exports.c_code.plcopen.text import structured_text, xml
from flexgen.exports.exported import Exported

PACKAGE = "flexgen.exports.c_code.plcopen"


@checked_types(own=("model", "directory"))
def export_plcopen(
    model: ModelLike,
    directory: str | os.PathLike[str] | None = None,
    *,
    stream: bool = True,
    force: bool = False,
) -> Exported:
    """Write function blocks for a PLC: inverse dynamics of the arm, and a stream.

    ``<name>.xml`` (PLCopen TC6 2.01) and ``<name>.st`` declare them. ``<name>_fb.h`` has the same
    variables in the same order as a struct in C, and ``<name>_fb.c`` the bodies, which take the
    address of an instance. Numbers are ``LREAL``. How a body in C is linked depends on the PLC.

    Parameters
    ----------
    model : str, Path, RobotModel or Equations
    directory : str or Path, optional
        Where to write; default: ``exports/<name>_plcopen``.
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
        The model cannot be read, has no streams, or has a name that IEC 61131-3 does not allow;
        the folder holds other files.

    Examples
    --------
    >>> print(flexgen.export_plcopen("elbow"))
    exports/elbow_plcopen
    """
    library = emit(model, streams=stream)
    name = library.name
    if name.endswith("_") or re.search(r"__", name):
        raise BuildError(
            f"name of the model, with its variant: given {name!r}, expected one without an "
            "underscore at its end or two in a row, as IEC 61131-3 demands"
        )
    made = blocks(library, stream)
    texts = library.texts() | {
        f"{name}.st": structured_text(made),
        f"{name}.xml": xml(name, made),
        f"{name}_fb.h": _header(library, made),
        f"{name}_fb.c": _dynamics(library),
    }
    if stream:
        texts[f"{name}_stream_fb.c"] = template(PACKAGE, "stream_fb.c", name).replace(
            "fb_MODELNAME_stream", made[-1].name.lower()
        )
    return library.write("plcopen", directory, texts, force=force)


def _header(library: Emitted, made: tuple[Block, ...]) -> str:
    """The structs of the blocks and the functions that are their bodies."""
    name = library.name
    NAME = library.name.upper()
    options = library.stream
    text = comment(
        f"{name}: variables and bodies of the function blocks. A block of {name}.st or "
        f"{name}.xml has the same variables in the same order, with natural alignment. Written "
        "by flexgen."
    )
    text = f"/*\n{text} */\n#ifndef {NAME}_FB_H\n#define {NAME}_FB_H\n\n#include <stdint.h>\n\n"
    if len(made) > 1 and options is not None:
        text += (
            f"#define FB_PERIOD {options.period!r} /* [s] between two calls of the stream */\n"
            f"#define FB_INTERVALS {options.intervals}\n"
            f"#define FB_SAMPLES {options.samples_per_interval}\n"
            f"#define FB_TOLERANCE {options.tolerance!r}\n"
            "\n"
        )
    text += '#ifdef __cplusplus\nextern "C" {\n#endif\n\n'
    for block in made:
        own = block.name.lower()
        text += f"/*\n{comment(block.doc)} */\n{struct(block)}\nvoid {own}_call({own} *fb);\n\n"
    return text + "#ifdef __cplusplus\n}\n#endif\n\n#endif\n"


def _dynamics(library: Emitted) -> str:
    """The body of the inverse dynamics."""
    name = library.name
    own = f"fb_{library.name.lower()}_inverse_dynamics"
    (function,) = (f for f in library.functions if f["name"] == "inverse_dynamics")
    work = f"    double work[{name.upper()}_WORK];\n" if function["work"] else ""
    last = ", work" if function["work"] else ""
    return f"""\
/* The function block of the inverse dynamics. Written by flexgen. */
#include "{name}_fb.h"

#include <string.h>

#include "{name}.h"

void {own}_call({own} *fb)
{{
    double tau_a[{name.upper()}_NA];
{work}    fb->status = (int32_t){name}_inverse_dynamics(fb->q_a, fb->v_a, fb->a_a, tau_a{last});
    fb->error = fb->status < 0;
    fb->valid = !fb->error;
    if (fb->valid) {{
        memcpy(fb->tau_a, tau_a, sizeof tau_a);
    }}
}}
"""
