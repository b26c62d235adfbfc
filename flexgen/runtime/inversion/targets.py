"""The computers that a library can be compiled for, and which of them this one is."""

from __future__ import annotations

import platform
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

from flexgen.base.errors import BuildError
from flexgen.runtime.processor import missing_instruction_sets

TargetName = Literal[
    "x86_64-linux", "aarch64-linux", "x86_64-windows", "x86_64-macos", "aarch64-macos"
]
TARGET_NAMES: tuple[TargetName, ...] = get_args(TargetName)
_SYSTEMS = {"linux": "linux", "win32": "windows", "darwin": "macos"}  # by sys.platform
_MACHINES = {"x86_64": "x86_64", "amd64": "x86_64", "aarch64": "aarch64", "arm64": "aarch64"}
_SUFFIXES = {"linux": "so", "windows": "dll", "macos": "dylib"}
# glibc 2.17 (2012): the oldest that manylinux2014 has.
_TRIPLES = {"linux": "linux-gnu.2.17", "windows": "windows-gnu", "macos": "macos"}
_OF_FMI = {"linux": "linux", "windows": "windows", "macos": "darwin"}
_FMI_2 = {"x86_64-linux": "linux64", "x86_64-windows": "win64", "x86_64-macos": "darwin64"}


@dataclass(frozen=True)
class Target:
    """A kind of computer: processor and operating system.

    Parameters
    ----------
    name : str
        One of `TARGET_NAMES`.
    """

    name: str

    @property
    def machine(self) -> str:
        """The processor: x86_64 or aarch64."""
        return self.name.partition("-")[0]

    @property
    def system(self) -> str:
        """The operating system: linux, windows or macos."""
        return self.name.partition("-")[2]

    @property
    def triple(self) -> str:
        """Its name for the compiler of the package ziglang, with the C library."""
        return f"{self.machine}-{_TRIPLES[self.system]}"

    @property
    def suffix(self) -> str:
        """Suffix of the names of its shared libraries: so, dll or dylib."""
        return _SUFFIXES[self.system]

    def fmi_name(self, version: str) -> str:
        """The folder of its binaries in an FMU of this version of FMI."""
        name = f"{self.machine}-{_OF_FMI[self.system]}"
        return _FMI_2.get(self.name, name) if version.startswith("2") else name


TARGETS: dict[str, Target] = {name: Target(name) for name in TARGET_NAMES}


def this_target() -> Target | None:
    """The target that this computer is; None where it is another kind."""
    machine = _MACHINES.get(platform.machine().lower())
    system = _SYSTEMS.get(sys.platform)
    return TARGETS.get(f"{machine}-{system}")


def library_suffix() -> str:
    """Suffix of the names of shared libraries on this computer."""
    return _SUFFIXES[_SYSTEMS.get(sys.platform, "linux")]


def refuse_other_computer(build: Mapping[str, Any]) -> None:
    """BuildError where a library, by this part of its manifest, was compiled for another kind of
    computer.
    """
    target = build.get("target")
    here = this_target()
    if target is not None and (here is None or target != here.name):
        raise BuildError(
            f"given a library for {target}, expected one for this "
            f"computer{f' ({here.name})' if here else ''}; load it there, or generate it again "
            "without target (--target)"
        )
    missing = missing_instruction_sets(build.get("instruction_sets", ()))
    if missing:
        raise BuildError(
            f"given a library with the instructions {', '.join(missing)}, which this processor "
            "does not have; generate it on this computer, or with isa='x86-64' (--isa x86-64)"
        )
