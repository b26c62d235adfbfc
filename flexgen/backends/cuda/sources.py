"""CUDA translation units of a generated library: its C files unchanged, five stub headers, and
kernels.

In a kernel of a function a thread evaluates one point. Arrays are structures of arrays, as those
of the batches in C: entry i of point k is ``x[i * n + k]``, so that the threads of a warp read
neighboring numbers. The kernels are rendered from the manifest; nothing of them is in the
generated folder.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from flexgen.base.errors import BuildError
from flexgen.runtime.arguments import PARAMETERS
from flexgen.runtime.files import AGAIN, read_verified

# What the emitted C needs of the standard headers, which NVRTC does not have; it declares the
# functions of <math.h>.
STUB_HEADERS: Mapping[str, str] = {
    "float.h": "#define FLT_EVAL_METHOD 0\n",
    "limits.h": "#define INT_MAX 2147483647\n",
    "math.h": (
        "#define INFINITY __int_as_float(0x7f800000)\n#define NAN __int_as_float(0x7fc00000)\n"
    ),
    "stddef.h": """\
typedef decltype(sizeof(0)) size_t;
typedef decltype((char *)0 - (char *)0) ptrdiff_t;
#ifndef NULL
#define NULL 0
#endif
""",
    "stdint.h": """\
typedef int int32_t;
typedef unsigned int uint32_t;
typedef decltype((char *)0 - (char *)0) int64_t;
typedef decltype(sizeof(0)) uint64_t;
typedef decltype(sizeof(0)) uintptr_t;
#define UINT32_C(x) x##u
#define UINT64_C(x) x##ull
#define INT32_MAX 2147483647
#define PTRDIFF_MAX 9223372036854775807ll
""",
}
# of what a kernel reports: the first point that failed, and in these bits minus its status
STATUS_BITS = 8


def read_files(folder: Path, manifest: Mapping[str, Any]) -> dict[str, str]:
    """The C files of a library by name, as `flexgen.generate` wrote them; BuildError where one is
    another.
    """
    texts = {}
    for file, digest in manifest["files"].items():
        if not file.endswith((".c", ".h")):
            continue
        try:
            content = read_verified(folder / file)
        except OSError as error:
            raise BuildError(
                f"{folder / file}: given no readable file ({error}); {AGAIN}"
            ) from error
        if hashlib.sha256(content).hexdigest() != digest:
            raise BuildError(f"{folder / file}: given another file than flexgen wrote; {AGAIN}")
        texts[file] = content.decode("ascii")
    return texts


def headers_of(files: Mapping[str, str]) -> dict[str, str]:
    """The names by which the C files include each other, and their texts; the stub headers too."""
    headers = dict(STUB_HEADERS)
    for file, text in files.items():
        name = PurePosixPath(file).name
        headers |= {name: text, f"../{name}": text}
    return headers


def kernel_text(manifest: Mapping[str, Any], files: Mapping[str, str], function: str) -> str:
    """The translation unit with the kernel ``k_<function>(n, inputs, outputs, failed)``.

    ``failed`` becomes the smallest ``k << STATUS_BITS | -status`` of the points k that failed.
    """
    name = manifest["name"]
    (described,) = (row for row in manifest["functions"] if row["name"] == function)
    inputs, outputs = ([port["name"] for port in described[key]] for key in ("inputs", "outputs"))
    shared = () if manifest.get("per_point") else (PARAMETERS,)
    arguments = [f"const {name}_real *__restrict__ {x}" for x in inputs] + [
        f"{name}_real *__restrict__ {x}" for x in outputs
    ]
    at = [x if x in shared else f"{x} + k" for x in (*inputs, *outputs)]
    source = _file_of(files, f"{name}_{function}.c", f"{name}.c")
    work = _workspace(files[source], function)
    space = f"    {name}_real work[{work}];\n" if work else ""
    return f"""\
/* {name}: CUDA kernel of {function}. */
#include "{PurePosixPath(source).name}"

extern "C" __global__ void k_{function}(
    ptrdiff_t n, {", ".join(arguments)}, unsigned long long *failed)
{{
    const ptrdiff_t k = (ptrdiff_t)blockIdx.x * blockDim.x + threadIdx.x;
{space}    if (k >= n) {{
        return;
    }}
    if (!({function}_evaluate_v({", ".join([*at, *["work"] * bool(work)])}, n) == 0)) {{
        const {name}_real *const in[] = {{{", ".join(at[: len(inputs)])}}};
        {name}_real *const out[] = {{{", ".join(at[len(inputs) :])}}};
        const int status = first_failed(&{function}_shape, in, out, 1, n);
        if (status != 0) {{
            atomicMin(failed, (unsigned long long)k << {STATUS_BITS} | (unsigned long \
long)-status);
        }}
    }}
}}
"""


def inversion_text(manifest: Mapping[str, Any], files: Mapping[str, str], work: int) -> str:
    """The translation unit with the kernel ``k_invert_many``, whose thread solves a problem in
    `work` reals of its own.

    The workspace is a local array: the hardware stores the same entry of all threads of a warp
    next to each other.
    """
    name = manifest["name"]
    main = _file_of(files, f"{name}_inversion.c", f"{name}.c")
    every = [
        _file_of(files, f"{name}_{row['name']}.c", f"{name}.c") for row in manifest["functions"]
    ]
    includes = "".join(
        f'#include "{PurePosixPath(file).name}"\n' for file in dict.fromkeys([main, *every])
    )
    many = manifest["sizes"].get("n_p", 0) > 0
    argument = f"const {name}_real *parameters, " if many else ""
    return f"""\
/* {name}: CUDA kernel of invert_many. */
{includes}
extern "C" __global__ void k_invert_many({name}_problems problems, {name}_samples samples,
    {argument}const {name}_real *q_start, {name}_inversion_options options,
    {name}_motion motion, {name}_invert_info *info, {name}_status *statuses)
{{
    const ptrdiff_t k = (ptrdiff_t)blockIdx.x * blockDim.x + threadIdx.x;
    alignas(16) {name}_real work[{work}];
    options.growth = 0; /* not on the card: its function would make the kernel larger */
    if (k < problems.count) {{
        const problem_arrays arrays = {{&problems, &samples, \
{"parameters" if many else "q_start"}, q_start,
            &options, &motion, info, statuses}};
        invert_problem(&arrays, k, work, {work});
    }}
}}
"""


def _file_of(files: Mapping[str, str], *names: str) -> str:
    """The first of these files that there is; a library in one source has only the last."""
    for name in names:
        for file in files:
            if PurePosixPath(file).name == name:
                return file
    raise BuildError(f"{names[0]}: given a library without this file; {AGAIN}")


def _workspace(text: str, function: str) -> int:
    """Reals of workspace of a function for a point, as its source says."""
    found = re.search(rf"\b{re.escape(function)}_shape = {{\s*(?:-?\d+,\s*){{3}}(\d+)", text)
    if found is None:
        raise BuildError(f"{function}: given a source without the shape of the function; {AGAIN}")
    return int(found[1])
