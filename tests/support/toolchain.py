"""Compilers, emulators and other programs that a test needs: found, or the test skips and names the Debian package."""

from __future__ import annotations

import shutil

import pytest

STRICT = (
    "-std=c99 -pedantic -Wall -Wextra -Wconversion -Wshadow -Wstrict-prototypes -Wmissing-prototypes -Werror".split()
)
STRICT += ["-Wdouble-promotion", "-Wundef"]
STRICT_CPP = "-x c++ -std=c++17 -pedantic -Wall -Wextra -Werror".split()

# Program -> Debian package.
PACKAGES = {
    "cc": "gcc",
    "gcc": "gcc",
    "c++": "g++",
    "g++": "g++",
    "clang": "clang",
    "clang++": "clang",
    "clang-format": "clang-format",
    "nm": "binutils",
    "cmake": "cmake",
    "pkg-config": "pkgconf",
    "aarch64-linux-gnu-gcc": "gcc-aarch64-linux-gnu libc6-dev-arm64-cross",
    "qemu-aarch64": "qemu-user",
    "arm-none-eabi-gcc": "gcc-arm-none-eabi libnewlib-arm-none-eabi",
    "arm-none-eabi-nm": "binutils-arm-none-eabi",
    "qemu-system-arm": "qemu-system-arm",
    "ffmpeg": "ffmpeg",
}

CC = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
needs_compiler = pytest.mark.skipif(CC is None, reason="no C compiler; install the Debian package gcc")


def tool(name: str) -> str:
    """The path of a program; skips the test where it is missing."""
    found = shutil.which(name)
    if found is None:
        pytest.skip(f"no {name}; install the Debian package {PACKAGES[name]}")
    return found


def tools(*names: str) -> None:
    """Skip the test unless all these programs are there."""
    missing = [name for name in names if shutil.which(name) is None]
    if missing:
        packages = " ".join(dict.fromkeys(PACKAGES[name] for name in missing))
        pytest.skip(f"no {', '.join(missing)}; install with: apt-get install {packages}")
