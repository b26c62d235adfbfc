"""C header with the table of a planned path, for the path sampler of the emitted libraries."""

from __future__ import annotations

import re

import numpy as np

from flexgen.codegen.emission.c_text import comment
from flexgen.codegen.emission.sampler_functions import SAMPLER_FUNCTIONS
from flexgen.codegen.emission.spec import library_name
from flexgen.codegen.statements.literals import literal
from flexgen.model.elements import RobotModel

PER_LINE = 4


def path_header(model: RobotModel, name: str, table: np.ndarray, duration: float) -> str:
    """The header of a path.

    Parameters
    ----------
    model : RobotModel
    name : str
        Of the move or program.
    table : ndarray (n,)
        Of `flexgen.paths.path.Path.table`.
    duration : float [s]

    Returns
    -------
    str
        C text: the array ``<library>_path_<name>`` and its length; other characters of the name
        become underscores, and a name that would be that of a function of the library gets one
        more.
    """
    library = library_name(model)
    plain = re.sub(r"[^A-Za-z0-9_]", "_", name)
    taken = f"path_{plain}" in {function.name for function in SAMPLER_FUNCTIONS}
    array = f"{library}_path_{plain}{'_' if taken else ''}"
    guard = f"{array}_H".upper()
    size = f"{array}_SIZE".upper()
    numbers = [literal(float(x), "double") for x in table]
    rows = [", ".join(numbers[k : k + PER_LINE]) for k in range(0, len(numbers), PER_LINE)]
    head = comment(
        f"{library}: the path {name}, {duration:.6g} s, for {library}_path_sample. Written by "
        "flexgen."
    )
    return (
        f"/*\n{head} */\n#ifndef {guard}\n#define {guard}\n\n"
        f'#include "{library}.h"\n\n'
        f"#define {size} {len(numbers)} /* numbers of the table */\n\n"
        f"static const {library}_real {array}[{size}] = {{\n    "
        + ",\n    ".join(rows)
        + "};\n\n#endif\n"
    )
