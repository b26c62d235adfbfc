"""NVRTC: from a translation unit to a cubin, kept in the user's cache of compiled objects.

No card, driver or CUDA toolkit is needed: NVRTC is in a wheel. ``-fmad=false`` rounds every
product, and without vector types a lane is one number: the results have the bits of the default
build on the CPU.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

from flexgen.base.errors import BuildError
from flexgen.codegen.build.object_cache import cache_folder, fetch_entry, keep_entry, one_at_a_time

_INSTALL = "install what the GPU needs: pip install 'flexgen-robotics[cuda]'"


def nvrtc() -> Any:
    """The bindings of NVRTC; BuildError where they or NVRTC are missing."""
    try:
        from cuda.bindings import nvrtc as bindings

        bindings.nvrtcVersion()
    except (ImportError, RuntimeError) as error:
        raise BuildError(
            f"device: given 'cuda' without NVRTC ({error}), expected its package; {_INSTALL}"
        ) from error
    return bindings


def options_of(name: str, architecture: str) -> list[str]:
    """The options of the compilation for an architecture such as ``sm_90``."""
    return [
        f"--gpu-architecture={architecture}",
        "-fmad=false",
        "-default-device",
        f"-D{name.upper()}_NO_VECTORS",
    ]


def compile_cached(name: str, text: str, headers: Mapping[str, str], architecture: str) -> bytes:
    """The cubin of a text, from the cache where it has it; BuildError where NVRTC refuses the
    text.
    """
    options = options_of(name, architecture)
    bindings = nvrtc()
    version = ".".join(map(str, bindings.nvrtcVersion()[1:]))
    digest = hashlib.sha256("\0".join(["nvrtc", version, *options, text]).encode())
    for header in sorted(headers):
        digest.update(f"{header}\0".encode() + hashlib.sha256(headers[header].encode()).digest())
    entry = f"{digest.hexdigest()}.cubin"
    folder = cache_folder()
    with one_at_a_time(folder, entry):
        found = None if folder is None else fetch_entry(folder, entry)
        if found is None:
            found, _ = compile_text(text, headers, options)
            if folder is not None:
                keep_entry(folder, entry, found)
    return found


def compile_text(text: str, headers: Mapping[str, str], options: list[str]) -> tuple[bytes, str]:
    """The cubin of a text with these headers by name, and the log of NVRTC; BuildError where it
    refuses the text. ``options``: the architecture first.
    """
    bindings = nvrtc()
    names = [x.encode() for x in headers]
    texts = [x.encode() for x in headers.values()]
    program = _check(
        bindings.nvrtcCreateProgram(text.encode(), b"kernel.cu", len(headers), texts, names)
    )
    try:
        given = [x.encode() for x in options]
        status, *_ = bindings.nvrtcCompileProgram(program, len(given), given)
        log = bytearray(_check(bindings.nvrtcGetProgramLogSize(program)))
        bindings.nvrtcGetProgramLog(program, log)
        said = log.decode(errors="replace").strip("\0 \n")
        if int(status) != 0:
            raise BuildError(
                f"NVRTC: given C that it does not compile for {options[0]}: {said or status.name}"
            )
        cubin = bytearray(_check(bindings.nvrtcGetCUBINSize(program)))
        _check(bindings.nvrtcGetCUBIN(program, cubin))
        return bytes(cubin), said
    finally:
        bindings.nvrtcDestroyProgram(program)


def _check(result: tuple[Any, ...]) -> Any:
    """The value of a call of NVRTC; BuildError where it failed."""
    status, *values = result
    if int(status) != 0:
        raise BuildError(f"NVRTC: given {status.name}, expected success; {_INSTALL}")
    return values[0] if values else None
