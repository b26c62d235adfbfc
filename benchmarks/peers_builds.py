"""Compilers, Pinocchio's headers, and a cache of what was compiled: everything the comparison
loads but ours.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
import sysconfig
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from flexgen.codegen.build import compiler

# The flags of our two builds, for CasADi's C too.
REPRODUCIBLE = (*compiler.REPRODUCIBLE, "-fPIC", "-shared")
NATIVE = (*compiler.NATIVE, "-fPIC", "-shared")
AVX2 = tuple("-march=x86-64-v3" if flag == "-march=native" else flag for flag in NATIVE)
PINOCCHIO = (
    *"-std=c++17 -O3 -march=native -DNDEBUG -fPIC -shared -w".split(),
    # as Pinocchio's package asks for
    *"-DBOOST_MPL_LIMIT_LIST_SIZE=30 -DBOOST_MPL_LIMIT_VECTOR_SIZE=30".split(),
    *"-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS -DBOOST_FUSION_INVOKE_MAX_ARITY=12".split(),
)
WORKERS = min(2, os.cpu_count() or 1)
HERE = Path(__file__).resolve().parent


@dataclass
class Builds:
    """Compiles what was not compiled before, two at a time, into a folder of files named by their
    content.
    """

    folder: Path
    pool: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(WORKERS))
    jobs: dict[Path, Future[None]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        self.cc = os.environ.get("CC", "cc")
        self._versions: dict[str, str] = {}

    def version(self, compiler: str) -> str:
        """First line of what a compiler says of its version."""
        if compiler not in self._versions:
            answer = subprocess.run(
                [compiler, "--version"], capture_output=True, text=True, check=True
            )
            self._versions[compiler] = answer.stdout.splitlines()[0]
        return self._versions[compiler]

    def text(self, name: str, text: str) -> Path:
        """A text as a file of the folder."""
        path = self.folder / name
        path.write_text(text)
        return path

    def submit(
        self,
        name: str,
        compiler: str,
        flags: tuple[str, ...],
        sources: list[Path],
        after: str = "",
    ) -> Path:
        """Where the compiled file will be once `wait` has returned; ``after``: words behind the
        sources.
        """
        content = hashlib.sha256(repr((self.version(compiler), flags, after)).encode())
        for path in _with_headers(sources):
            content.update(path.read_bytes())
        path = self.folder / f"{name}-{content.hexdigest()[:12]}.so"
        if path not in self.jobs and not path.exists():
            command = [compiler, *flags, *map(str, sources), "-o", str(path), *after.split()]
            self.jobs[path] = self.pool.submit(_compile, command, path)
        return path

    def wait(self) -> dict[Path, str]:
        """Until all that was submitted is compiled; what the compiler said, by the file that is
        missing for it.
        """
        failed = {}
        for path, job in self.jobs.items():
            error = job.exception()
            if error is not None:
                failed[path] = str(error)
        self.jobs.clear()
        return failed


def _with_headers(sources: list[Path]) -> list[Path]:
    """The sources and the headers of their folders that they include."""
    found = list(sources)
    for path in found:  # grows while it is read
        for name in re.findall(r'^#include "(.+)"', path.read_text(), re.MULTILINE):
            header = path.parent / name
            if header.exists() and header not in found:
                found.append(header)
    return found


def _compile(command: list[str], path: Path) -> None:
    aside = path.with_suffix(".part")
    command = [str(aside) if word == str(path) else word for word in command]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    if answer.returncode != 0:
        raise RuntimeError(f"{' '.join(command)}\n{answer.stderr[:2000]}")
    aside.rename(path)


@dataclass(frozen=True)
class Pinocchio:
    """Folders of headers, or what is missing of them."""

    includes: tuple[Path, ...]
    missing: tuple[str, ...]

    def flags(self, more: tuple[str, ...] = ()) -> tuple[str, ...]:
        """Flags of the compiler."""
        return (
            *PINOCCHIO,
            *more,
            *(word for folder in self.includes for word in ("-isystem", str(folder))),
        )


def find_pinocchio() -> Pinocchio:
    """Headers of Pinocchio (package pin) and Eigen (package cmeel-eigen, libeigen3-dev, or
    $EIGEN_INCLUDE).
    """
    prefix = Path(sysconfig.get_paths()["purelib"]) / "cmeel.prefix" / "include"
    missing = []
    if not (prefix / "pinocchio" / "algorithm" / "rnea.hpp").exists():
        missing.append("Pinocchio's headers: pip install pin")
    places = [prefix / "eigen3", Path("/usr/include/eigen3"), Path("/usr/local/include/eigen3")]
    if os.environ.get("EIGEN_INCLUDE"):
        places.insert(0, Path(os.environ["EIGEN_INCLUDE"]))
    eigen = next((place for place in places if (place / "Eigen" / "Core").exists()), None)
    if eigen is None:
        missing.append(
            "Eigen's headers: pip install cmeel-eigen, or apt-get install libeigen3-dev, or set "
            "EIGEN_INCLUDE"
        )
    if shutil.which("g++") is None:
        missing.append("a C++ compiler: apt-get install g++")
    return Pinocchio((prefix, eigen) if eigen is not None else (prefix,), tuple(missing))


@dataclass(frozen=True)
class Mujoco:
    """Folder of MuJoCo's package, None where it is not installed; its shared library."""

    folder: Path | None
    library: Path | None

    def submit(self, builds: Builds) -> Path:
        """MuJoCo's side, compiled; the algorithms are those of the package's library."""
        flags = (
            *"-std=c11 -O3 -march=native -fPIC -shared -I".split(),
            str(self.folder / "include"),
        )  # type: ignore[operator]
        assert self.library is not None
        after = f"{self.library} -Wl,-rpath,{self.library.parent}"
        return builds.submit("mujoco", builds.cc, flags, [HERE / "peers_mujoco.c"], after)


def find_mujoco() -> Mujoco:
    """The package mujoco of this environment."""
    folder = Path(sysconfig.get_paths()["purelib"]) / "mujoco"
    library = next(iter(sorted(folder.glob("libmujoco.*"))), None)
    return Mujoco(folder if library is not None else None, library)


def package_version(name: str) -> str:
    """Version of an installed package, "-" where there is none."""
    try:
        return version(name)
    except PackageNotFoundError:
        return "-"


def eigen_version(pinocchio: Pinocchio) -> str:
    """Version of Eigen as its headers say."""
    macros = (pinocchio.includes[-1] / "Eigen" / "src" / "Core" / "util" / "Macros.h").read_text()
    words = ("EIGEN_WORLD_VERSION", "EIGEN_MAJOR_VERSION", "EIGEN_MINOR_VERSION")
    return ".".join(macros.split(f"#define {word} ")[1].split()[0] for word in words)
