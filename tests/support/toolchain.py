"""Compilers, emulators and other programs that a test needs: found, or the test skips and names
the Debian package.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

STRICT = (
    "-std=c99 -pedantic -Wall -Wextra -Wconversion -Wshadow -Wstrict-prototypes "
    "-Wmissing-prototypes -Werror"
).split()
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
    "wine": "wine64",
}

CC = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
needs_compiler = pytest.mark.skipif(
    CC is None, reason="no C compiler; install the Debian package gcc"
)


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


def wine(folder: Path) -> tuple[str, dict[str, str]]:
    """The loader of Wine and its environment, with a prefix of its own in a folder; skips the test
    without Wine.
    """
    # of Debian's wine64, which is not on the PATH
    places = ("/usr/lib/wine", "/usr/lib/x86_64-linux-gnu/wine")
    found = (
        shutil.which("wine64")
        or shutil.which("wine")
        or shutil.which("wine64", path=os.pathsep.join(places))
    )
    if found is None:
        pytest.skip(f"no wine; install the Debian package {PACKAGES['wine']}")
    environment = os.environ | {
        "WINEPREFIX": str(folder / "wine"),
        "WINEDEBUG": "-all",
        "WINEDLLOVERRIDES": "mscoree=",
    }
    subprocess.run(
        [found, "cmd", "/c", "exit"],
        env=environment,
        capture_output=True,
        check=False,
        timeout=120,
    )
    return found, environment
