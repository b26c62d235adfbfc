"""The sources of a library under strict warnings, and under options that change arithmetic.

Compilers: GCC and Clang, where they are installed, and the Clang of the package ziglang.
"""

from __future__ import annotations

import ctypes
import importlib.util
import json
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import flexgen

STRICT = ["-Wall", "-Wextra", "-Werror", "-pedantic"]
LEVELS = ("-O0", "-O1", "-O2", "-O3")
STANDARDS = ("-std=c99", "-std=c11", "-std=c17", "-xc++ -std=c++11", "-xc++ -std=c++17")
MODELS = ("elbow", "planar5_nmp", "manutec_r3")
# Functions whose torques and poses are compared: products, sums and sines.
COMPARED = ("inverse_dynamics", "forward_kinematics")


def command(compiler: str) -> list[str]:
    """The words that run a compiler; skips the test where it is not there."""
    if compiler == "zig":
        if importlib.util.find_spec("ziglang") is None:
            pytest.skip("no ziglang; install it with pip")
        # without it, zig adds checks at run time
        return [sys.executable, "-m", "ziglang", "cc", "-fno-sanitize=all"]
    if shutil.which(compiler) is None:
        pytest.skip(f"no {compiler}; install the Debian package {compiler}")
    return [compiler]


@cache
def sources(name: str, folder: Path) -> Path:
    parts = ("derivatives", "force", "limits")
    return flexgen.generate(name, folder / name, build=False, parts=parts).directory


@pytest.fixture(scope="module")
def where(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("strict")


def warnings(words: list[str], files: list[Path], folder: Path) -> list[str]:
    """Messages of a compiler about sources, each compiled alone."""

    def said(number: int) -> str:
        output = f"{number}.o"
        done = subprocess.run(
            [*words, f"-I{folder}", "-c", str(files[number]), "-o", output],
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
        )
        return done.stderr if done.returncode else ""

    with ThreadPoolExecutor(2) as threads:
        return [text for text in threads.map(said, range(len(files))) if text]


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_what_inlines_most_is_silent(compiler: str, where: Path) -> None:
    """The hand-written sources at the level at which compilers see the most, and one as C++."""
    folder = sources("elbow", where)
    written = [folder / "src" / f"elbow_{name}.c" for name in ("path_sampler", "gravity")]
    assert warnings([*command(compiler), "-std=c99", "-O3", *STRICT], written, folder) == []
    assert warnings([*command(compiler), "-xc++", "-O0", *STRICT], written, folder) == []


@pytest.mark.slow
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize("name", MODELS)
def test_all_sources_are_silent(name: str, compiler: str, where: Path) -> None:
    """All at -O3, those of the elbow at each level, and each standard of C and C++."""
    folder = sources(name, where)
    files = [folder / "example.c", *sorted((folder / "src").glob("*.c"))]
    words = [*command(compiler), *STRICT]
    for level in LEVELS if name == "elbow" else LEVELS[-1:]:
        assert warnings([*words, "-std=c99", level], files, folder) == [], level
    for standard in STANDARDS:
        assert warnings([*words, *standard.split(), "-fsyntax-only"], files, folder) == [], (
            standard
        )


@pytest.mark.parametrize("compiler", ["gcc"])
def test_a_planted_variable_without_a_value_is_seen(
    compiler: str, where: Path, tmp_path: Path
) -> None:
    folder = sources("elbow", where)
    text = (folder / "src" / "elbow_gravity.c").read_text()
    planted = tmp_path / "planted.c"
    planted.write_text(text + "int planted(int);\nint planted(int a) { int b; return a + b; }\n")
    words = [*command(compiler), "-std=c99", "-O3", *STRICT, f"-I{folder / 'src'}"]
    (said,) = warnings(words, [planted], folder)
    assert "uninitialized" in said


# --- arithmetic ---
FAST = (
    "-ffast-math",
    "-funsafe-math-optimizations",
    "-fassociative-math -fno-signed-zeros -fno-trapping-math",
    "-freciprocal-math",
    "-ffinite-math-only",
    "-ffast-math -fno-finite-math-only",
)


def results(words: list[str], folder: Path, target: Path) -> list[bytes] | str:
    """The bits of some functions at 20 random states; the compiler's error where it refuses."""
    name = folder.name
    files = [str(folder / "src" / f"{name}_{function}.c") for function in COMPARED]
    more = ["-std=c99", "-w", "-fPIC", f"-I{folder}", "-c", *files]
    place = target.with_suffix("")
    place.mkdir()
    done = subprocess.run([*words, *more], cwd=place, capture_output=True, text=True, check=False)
    if done.returncode:
        return done.stderr
    # Linked without these options: with them the library sets the processor to flush denormal
    # numbers to zero when it is loaded, for all that this process computes later.
    compiler = [word for word in words if not word.startswith("-f")]
    objects = [str(one) for one in place.glob("*.o")]
    link = [*compiler, "-shared", "-o", str(target), *objects, "-lm"]
    subprocess.run(link, capture_output=True, text=True, check=True)
    library = ctypes.CDLL(str(target))
    described = json.loads((folder / "manifest.json").read_text())["functions"]
    functions = {one["name"]: one for one in described}
    rng = np.random.default_rng(2)
    found = []
    for _ in range(20):
        for function in COMPARED:
            row = functions[function]
            given = [rng.uniform(-1.0, 1.0, port["shape"]) for port in row["inputs"]]
            taken = [np.zeros(port["shape"]) for port in row["outputs"]]
            pointers = [ctypes.c_void_p(x.ctypes.data) for x in (*given, *taken)]
            assert getattr(library, f"{name}_{function}")(*pointers) == 0
            found += [x.tobytes() for x in taken]
    assert np.float64(5e-324) * 1.0 > 0.0, "denormal numbers are zero in this process"
    return found


@pytest.mark.parametrize("compiler", ["gcc", "clang", pytest.param("zig", marks=pytest.mark.slow)])
def test_options_that_change_arithmetic_are_refused_or_have_no_effect(
    compiler: str, where: Path, tmp_path: Path
) -> None:
    """Clang has no macro for most of them: -funsafe-math-optimizations gave torques 19 % off."""
    folder = sources("planar5_nmp", where)
    words = [*command(compiler), "-O2"]
    right = results([*words, "-ffp-contract=off"], folder, tmp_path / "right.so")
    assert isinstance(right, list)
    refused = []
    for number, flags in enumerate(FAST):
        found = results(
            [*words, *flags.split(), "-ffp-contract=off"], folder, tmp_path / f"{number}.so"
        )
        if isinstance(found, str):
            assert "compile without -ffast-math" in found, found
            refused.append(flags)
            continue
        assert found == right, flags
    assert set(refused) >= {"-ffast-math", "-ffinite-math-only"}
    # GCC has macros for all of them, Clang takes the others back
    assert len(refused) == (6 if compiler == "gcc" else 2)


def test_planted_arithmetic_without_the_pragmas_is_seen(where: Path, tmp_path: Path) -> None:
    """The sources as they were: Clang removes the rounding that sine and cosine need."""
    folder = tmp_path / "planar5_nmp"
    shutil.copytree(sources("planar5_nmp", where), folder)
    header = folder / "src" / "planar5_nmp_kernel.h"
    lines = header.read_text().splitlines()
    header.write_text("\n".join(line for line in lines if not line.startswith("#pragma")) + "\n")
    words = [*command("clang"), "-O2", "-ffp-contract=off"]
    right = results(words, folder, tmp_path / "right.so")
    wrong = results(
        [*words, "-funsafe-math-optimizations", "-ffp-contract=off"], folder, tmp_path / "x.so"
    )
    assert isinstance(wrong, list)
    assert wrong != right
