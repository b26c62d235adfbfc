"""The compiled parts of an FMU: for this platform, or for others by the package ziglang."""

from __future__ import annotations

import platform
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flexgen.base.checks.types_of_values import items_of
from flexgen.base.errors import ArgumentError, BuildError
from flexgen.base.files.atomic_files import temporary_folder
from flexgen.codegen.build.compiler import NO_COMPILER, Compiler, find_compiler, run_compiler
from flexgen.exports.fmu.block import Block
from flexgen.runtime.inversion.targets import TARGETS, Target, this_target

SOURCE = "all.c"  # the only one
_FLAGS = ("-Werror=implicit-function-declaration",)
_VERSIONS = ("2.0", "3.0")


@dataclass(frozen=True)
class Binary:
    """A binary to be made: the name of its platform in FMI, and its compiler."""

    platform: str
    compiler: Compiler


def binaries_of(version: str, binary: bool, platforms: Any) -> tuple[Binary, ...]:
    """The binaries that an FMU is to have; `platforms` and errors as of `flexgen.export_fmu`."""
    if platforms is not None and not binary:
        raise ArgumentError(
            "platforms: given for an FMU without binary, expected them with binary=True only"
        )
    if not binary:
        return ()
    if platforms is None:
        compiler = _compiler()
        here = this_target()
        if here is None:
            raise BuildError(
                f"platform: given {sys.platform} on {platform.machine()}, expected Linux, "
                "Windows or macOS on x86-64 or ARM; write the sources only (binary=False) and "
                "compile them with the importing program"
            )
        return (Binary(here.fmi_name(version), compiler),)
    made = []
    for target in _chosen(platforms, version):
        if (found := find_compiler(target=target.name)) is not None:  # else it raises
            made.append(Binary(target.fmi_name(version), found))
    return tuple(made)


def _chosen(platforms: Any, version: str) -> list[Target]:
    """The targets that platforms name, each once."""
    names = [platforms] if isinstance(platforms, str) else items_of(platforms)
    known = {target.fmi_name(each): target for each in _VERSIONS for target in TARGETS.values()}
    unknown = [name for name in names or () if name not in (*known, "all")]
    if not names or unknown:
        offered = ", ".join(target.fmi_name(version) for target in TARGETS.values())
        shown = unknown[0] if unknown else platforms
        raise ArgumentError(
            f"platforms: given {shown!r}, expected all or one or more of {offered}"
        )
    if "all" in names:
        return list(TARGETS.values())
    return list(dict.fromkeys(known[name] for name in names))


def _compiler() -> Compiler:
    """The compiler, for every computer with a processor of this kind."""
    here = this_target()
    found = find_compiler(
        isa="x86-64" if here is not None and here.machine == "x86_64" else "native"
    )
    if found is None:
        raise BuildError(
            f"{NO_COMPILER}, or write the sources only: binary=False in Python, --no-binary on "
            "the command line"
        )
    return found


def compile_binary(block: Block, texts: Mapping[str, str], compiler: Compiler) -> bytes:
    """The shared library of the source; BuildError where the compiler fails."""
    with temporary_folder() as folder:
        for file, text in texts.items():
            if file.startswith("sources/"):
                (folder / Path(file).name).write_text(text, encoding="utf-8", newline="\n")
        straight = compiler.straight if block.straight else ()
        words = [*compiler.command, *compiler.flags, *_FLAGS, *straight]
        run_compiler("C compiler", [*words, "-c", SOURCE, "-o", "all.o"], folder, "all.o")
        # calls within the library stay there, whatever other libraries the program has loaded
        own = ["-Wl,-Bsymbolic"] if compiler.suffix == "so" else []
        library = f"{block.name}.{compiler.suffix}"
        words = compiler.link_command(*own, "-o", library, "all.o", install_name=library)
        run_compiler("linker", words, folder, library)
        return (folder / library).read_bytes()
