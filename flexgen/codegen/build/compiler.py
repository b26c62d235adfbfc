"""The C compiler: find it, read its version, target and macros, and run it on the sources of a
library.

Where none is on the PATH, it is that of the package ziglang, if installed (extra ``compiler``).

No shell is involved, and of the flags in ``$CC`` only those that change speed or the kind of
machine are accepted.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import re
import shlex
import shutil
import subprocess
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, get_args

from flexgen.base.calls.progress import throttle
from flexgen.base.errors import ArgumentError, BuildError
from flexgen.codegen.build.object_cache import Objects, one_at_a_time
from flexgen.codegen.build.programs import Programs
from flexgen.runtime.inversion.targets import TARGETS, Target, library_suffix
from flexgen.runtime.processor import INSTRUCTION_SETS

# The same bits with every compiler, processor and width of its vectors: products and sums are not
# contracted, and GCC's vectorizer is off, because it contracts nevertheless where the processor
# has fused instructions. That loses nothing: the sources have their own vectors, and what GCC
# makes of the rest is slower in the sum (benchmarks/sizes.md). A sqrt without errno is one
# instruction and needs no library.
REPRODUCIBLE = ("-std=c99", "-O2", "-ffp-contract=off", "-fno-tree-vectorize", "-fno-math-errno")
NATIVE = ("-std=c99", "-O3", "-march=native", "-ffp-contract=fast", "-fno-math-errno")
# Solvers with unrolled loops take a tenth less time: as little as with -O3, which takes half as
# long again to compile.
SOLVERS = ("inversion.c",)
SOLVER_FLAGS = ("-funroll-loops",)
# Without these passes of GCC the hand-written sources compile in a quarter less time, and are as
# fast.
QUICK_FLAGS = (
    "-fira-region=one",
    "-fno-dse",
    "-fno-gcse",
    "-fno-tree-pre",
    "-fno-rename-registers",
    "-fno-web",
)
# The emitted mathematics is straight-line code in good order: what GCC does beyond this level
# takes a third of the time of the compilation and makes nothing faster (other compilers inline
# less at it).
STRAIGHT_FLAGS = ("-O1", "-fschedule-insns2")
# The emitted code has no common subexpressions and no dead code: without GCC's passes for these,
# the functions of the library compile in a fifth less time, and are as fast.
LEAN_FLAGS = (
    "-fno-dse",
    "-fno-tree-ccp",
    "-fno-tree-copy-prop",
    "-fno-tree-dominator-opts",
    "-fno-tree-dse",
    "-fno-tree-fre",
)
# Instruction sets that a library can be compiled for; all give the same bits.
IsaName = Literal["native", "x86-64", "x86-64-v2", "x86-64-v3", "x86-64-v4"]
ISAS: tuple[IsaName, ...] = get_args(IsaName)
SHARED = ("-fPIC", "-fvisibility=hidden")
OPENMP = "-fopenmp"

SECONDS_PER_BYTE = 7e-6  # of one core, to compile a source
LONG = 20.0  # s; the expected time of a longer compilation is reported

NO_COMPILER = (
    "C compiler: given none, expected cc, gcc or clang on the PATH or $CC; install one (such as "
    "the package gcc or build-essential, or without root rights pip install "
    "'flexgen-robotics[compiler]')"
)

_COMPILERS = ("cc", "gcc", "clang")
_ARCHIVERS = ("ar", "gcc-ar", "llvm-ar")
_ALLOWED_FLAG = re.compile(
    r"-(O[0-3]|pipe|m32|m64|m(arch|tune)=[a-z0-9.-]+|ffp-contract=(off|on|fast))\Z"
)
# All that the sources include: the compiler's macros, which depend on its version and target, and
# these headers.
_OUTSIDE = (
    "#include <float.h>\n#include <math.h>\n#include <stddef.h>\n#include <stdint.h>\n"
    "#ifdef _OPENMP\n#include <omp.h>\n#endif\n"
)


_WORLD = ("DBL_EPSILON", "size_t")  # words of the preprocessed text of _OUTSIDE
# macros of compilers that also define GCC's
_LIKE_GCC = ("__clang__", "__INTEL_COMPILER", "__NVCOMPILER")
_DEFINED = re.compile(r"^#define (__\w+__) 1$", re.MULTILINE)


@dataclass(frozen=True)
class Compiler:
    """A C compiler with its flags.

    Parameters
    ----------
    command : tuple of str
        The words to run it with.
    version : str
        First line of its version text.
    flags : tuple of str
        All flags, those of ``$CC`` after the usual ones, so that they have priority.
    identity : str
        SHA-256 of what its output depends on besides the sources: version, flags, target (with
        ``-march=native`` the processor), and the system's headers.
    instruction_sets : tuple of str
        Vector instruction sets of x86-64 that the output uses; names as in
        `flexgen.runtime.processor`.
    straight, functions, solvers, others : tuple of str
        More flags, for sources with emitted mathematics and other C, for those with the
        mathematics of a function alone, for `SOLVERS`, and for the other hand-written sources.
    archiver : tuple of str
        The words to run its own archiver with; empty: the archiver is on the PATH.
    target : Target, optional
        The kind of computer that it compiles for; None: this one.
    """

    command: tuple[str, ...]
    version: str
    flags: tuple[str, ...]
    identity: str
    instruction_sets: tuple[str, ...] = ()
    straight: tuple[str, ...] = ()
    functions: tuple[str, ...] = ()
    solvers: tuple[str, ...] = ()
    others: tuple[str, ...] = ()
    archiver: tuple[str, ...] = ()
    target: Target | None = None

    @property
    def suffix(self) -> str:
        """Suffix of the names of its shared libraries."""
        return library_suffix() if self.target is None else self.target.suffix

    def link_command(self, *words: str, install_name: str = "") -> list[str]:
        """The command that links a shared library.

        Parameters
        ----------
        *words : str
            Its objects and more flags.
        install_name : str
            Of a library for macOS, by which programs that were linked with it look for it below
            their ``@rpath``.
        """
        named = (
            [f"-Wl,-install_name,@rpath/{install_name}"]
            if install_name and self.suffix == "dylib"
            else []
        )
        # without tables for a debugger, which the package ziglang adds and which have names of
        # folders
        stripped = ["-s"] if self.target is not None else []
        return [*self.command, *self.flags, *stripped, "-shared", *named, *words, "-lm"]


def find_compiler(
    *, native: bool = False, openmp: bool = False, isa: str = "native", target: str | None = None
) -> Compiler | None:
    """The compiler of $CC, else the first of cc, gcc, clang and the package ziglang; None where
    there is none.

    Parameters
    ----------
    native : bool
        True: the fastest flags for this processor, which contract products and sums; else those
        for the same bits everywhere.
    openmp : bool
        True: batches on all cores.
    isa : str
        One of `ISAS`: the instruction set; "native": that of this processor. A ``-march`` in $CC
        has priority.
    target : str, optional
        One of `TARGETS`: the kind of computer, for which the package ziglang compiles, whatever
        $CC is; the instruction set "native" is then what all such computers have.

    Raises
    ------
    BuildError
        Where $CC cannot be used, the compiler does not know a flag, or the package ziglang is
        needed and missing.
    """
    if isa not in ISAS:
        raise BuildError(f"isa: given {isa!r}, expected one of {', '.join(ISAS)}")
    if target is not None and target not in TARGETS:
        raise BuildError(f"target: given {target!r}, expected one of {', '.join(TARGETS)}")
    return _find_compiler(
        native, openmp, isa, target, os.environ.get("CC"), os.environ.get("PATH")
    )


@lru_cache(maxsize=16)  # asking the compiler takes longer than many a computation
def _find_compiler(
    native: bool, openmp: bool, isa: str, other: str | None, cc: str | None, path: str | None
) -> Compiler | None:
    """The compiler in this environment, asked for its version and its predefined macros; None
    where there is none.

    ``native``, ``openmp``, ``isa``: as in `find_compiler`; ``other``: name of the target where it
    is not this computer; ``cc``, ``path``: variables of the environment, here only so that a cache
    tells them apart. BuildError where the compiler cannot be run, refuses the flags or does not
    preprocess C.
    """
    chosen = _choose_command() if other is None else _cross_command(other)
    if chosen is None:
        return None
    program = tuple(word for word in chosen if not word.startswith("-"))
    own = [word for word in chosen if word.startswith("-")]
    # the last has priority
    flags = [*(NATIVE if native else REPRODUCIBLE), *SHARED, *[OPENMP] * openmp, *own]
    flags += [] if other is None else ["-target", TARGETS[other].triple]
    packaged = chosen == packaged_compiler()
    # in Zig "-" takes a feature away
    march = f"-march={isa.replace('-', '_') if packaged else isa}"
    decided = (
        native
        or any(word.startswith("-m") for word in own)
        or (other is not None and isa == "native")
    )
    target = [] if decided else [march]
    try:
        version = _output([*chosen, "--version"], "").stdout.strip().partition("\n")[0]
        world = _output([*program, *flags, *target, "-E", "-dD", "-x", "c", "-"], _OUTSIDE)
        # a compiler for another processor: its own default
        if world.returncode != 0 and isa == "native":
            target = []
            world = _output([*program, *flags, "-E", "-dD", "-x", "c", "-"], _OUTSIDE)
        flags += target
    except OSError as error:
        raise BuildError(
            f"C compiler: given {chosen[0]!r}, which cannot be run ({error.strerror})"
        ) from None
    if world.returncode != 0:
        message = _errors(world)
        hint = (
            "; it has no OpenMP: leave openmp (--openmp) out, or install it (libomp)"
            if openmp
            else ""
        )
        raise BuildError(
            f"C compiler: given {shlex.join(chosen)!r} with {shlex.join(flags)}, which fails:\n"
            f"  {message}{hint}"
        )
    if not all(word in world.stdout for word in _WORLD):
        raise BuildError(
            f"C compiler: given {shlex.join(chosen)!r}, which does not preprocess C, expected "
            "gcc, clang or another C compiler; change CC or unset it"
        )
    gcc = "__GNUC__" in world.stdout and not any(word in world.stdout for word in _LIKE_GCC)
    leveled = any(word.startswith("-O") for word in own)
    straight = STRAIGHT_FLAGS if gcc and not (native or leveled) else ()
    functions = (*straight, *LEAN_FLAGS) if straight else ()
    others = QUICK_FLAGS if gcc else ()
    solvers = (*SOLVER_FLAGS, *others)
    identity = hashlib.sha256(
        "\0".join((version, *flags, *solvers, *functions, world.stdout)).encode()
    ).hexdigest()
    used = tuple(
        INSTRUCTION_SETS[word]
        for word in _DEFINED.findall(world.stdout)
        if word in INSTRUCTION_SETS
    )
    archiver = (program[0], "ar") if packaged else ()
    more = (
        straight,
        functions,
        solvers,
        others,
        archiver,
        None if other is None else TARGETS[other],
    )
    return Compiler(program, version, tuple(flags), identity, used, *more)


def _cross_command(target: str) -> list[str]:
    """The words that run the C compiler for another kind of computer; BuildError where it is not
    installed.
    """
    found = packaged_compiler()
    if found is None:
        raise BuildError(
            f"target: given {target!r}, for which the package ziglang compiles, and it is not "
            "installed; install it: pip install 'flexgen-robotics[compiler]'"
        )
    return found


def check_build(native: bool, openmp: bool, isa: str, target: str | None) -> dict[str, Any]:
    """The choices of `find_compiler` by name; ArgumentError for those that are not offered."""
    options = {"native": native, "openmp": openmp, "isa": isa, "target": target}
    if isa not in ISAS:
        raise ArgumentError(f"isa: given {isa!r}, expected one of {', '.join(ISAS)}")
    if target is None:
        return options
    if target not in TARGETS:
        raise ArgumentError(f"target: given {target!r}, expected one of {', '.join(TARGETS)}")
    for name, given in (("native", native), ("openmp", openmp)):
        if given:
            raise ArgumentError(
                f"{name}: given with target {target!r}, expected it for this computer only"
            )
    if isa != "native" and TARGETS[target].machine != "x86_64":
        raise ArgumentError(
            f"isa: given {isa!r} with target {target!r}, expected a target with x86_64"
        )
    return options


def _choose_command() -> list[str] | None:
    """The words of $CC, or of the first compiler found."""
    given = os.environ.get("CC", "")
    try:
        # on Windows "\\" is part of a path, and quotation marks stay
        chosen = [word.strip('"') for word in shlex.split(given, posix=os.name == "posix")]
    except ValueError as error:
        raise BuildError(
            f"$CC: given {given!r}, expected a command ({str(error).lower()})"
        ) from None
    if not chosen:
        found = next((name for name in _COMPILERS if shutil.which(name)), None)
        return packaged_compiler() if found is None else [found]
    for word in chosen:
        if word.startswith("-") and not _ALLOWED_FLAG.match(word):
            raise BuildError(
                f"$CC: given the flag {word!r}, expected optimization, -m32, -m64 or -march=... "
                "only"
            )
        if not word.startswith("-") and shutil.which(word) is None:
            raise BuildError(
                f"$CC: given {word!r}, expected a program that can be found; unset CC or "
                "install it"
            )
    return chosen


def packaged_compiler() -> list[str] | None:
    """The words that run the C compiler of the package ziglang; None where it is not installed."""
    found = importlib.util.find_spec("ziglang")
    folders = [] if found is None else list(found.submodule_search_locations or ())
    program = next(
        (made for folder in folders if (made := shutil.which("zig", path=folder))), None
    )
    return None if program is None else [program, "cc"]


def _output(
    command: Sequence[str], text: str, folder: Path | None = None, programs: Programs | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a program on a text; by default in the root, so that its output does not depend on the
    folder.
    """
    return (programs or Programs()).run(
        command,
        text,
        folder or Path(os.sep),
        {**os.environ, "LC_ALL": "C", "ZERO_AR_DATE": "1"},
    )


def _errors(result: subprocess.CompletedProcess[str]) -> str:
    """The first lines of the errors of a program."""
    lines = [line for line in result.stderr.splitlines() if line.strip()]
    errors = [line for line in lines if "error" in line.lower()] or lines
    return "\n  ".join(errors[:5]) or f"exit status {result.returncode}, without a message"


def run_compiler(
    what: str,
    command: Sequence[str],
    folder: Path,
    written: str,
    programs: Programs | None = None,
) -> None:
    """Run ``command`` in ``folder``, where it writes the file ``written``; ``what`` names the
    program in errors.

    BuildError with the first errors where it fails or leaves no file.
    """
    answer = _output(command, "", folder, programs)
    if answer.returncode != 0:
        raise BuildError(
            f"the {what} failed; the directory is as it was before:\n  {_errors(answer)}"
        )
    if not (folder / written).is_file():
        raise BuildError(
            f"the {what} {command[0]!r} reported success but wrote no {written}; the directory "
            "is as it was before; check CC and the programs on the PATH"
        )


def build_libraries(
    folder: Path,
    name: str,
    sources: Sequence[str],
    headers: Sequence[str],
    compiler: Compiler,
    log: Callable[[str], None],
    *,
    fresh: bool = False,
) -> dict[str, Any]:
    """Compile the sources in a folder, link the shared library and make the static one.

    Parameters
    ----------
    folder : Path
        Where the sources are and the libraries go to.
    name : str
        Of the library.
    sources, headers : sequence of str
        Names of the files.
    compiler : Compiler
    log : callable
        Called with a line of text before each step.
    fresh : bool
        True: compile all sources, also those in the cache of objects.

    Returns
    -------
    dict
        The part of the manifest that describes the build.
    """
    archiver = compiler.archiver or tuple(found for found in _ARCHIVERS if shutil.which(found))[:1]
    if not archiver:
        raise BuildError(
            f"ar: given none, expected one of {', '.join(_ARCHIVERS)} on the PATH; install "
            "binutils"
        )
    if compiler.target is not None:
        log(f"for {compiler.target.name}: the C compiler is that of the package ziglang")
    elif compiler.archiver:
        log("no cc, gcc or clang on the PATH: the C compiler is that of the package ziglang")
    functions = {file for file in sources if _mathematics_of(folder / file).exists()}

    def flags_of(file: str) -> list[str]:
        if Path(file).name in [f"{name}_{solver}" for solver in SOLVERS]:
            return [*compiler.solvers]
        return [*(compiler.functions if file in functions else compiler.others)]

    stored = Objects(
        compiler.identity, {file: (folder / file).read_bytes() for file in headers}, flags_of
    )
    with one_at_a_time(stored.folder, name, log):
        _compile(stored, folder, sources, compiler, flags_of, log, fresh=fresh)
    log("linking")
    objects = [_object(file) for file in sources]
    suffix = compiler.suffix
    linked = f"linked.{suffix}"
    static = f"lib{name}.a"
    run_compiler(
        "linker",
        compiler.link_command("-o", linked, *objects, install_name=f"lib{name}.dylib"),
        folder,
        linked,
    )
    run_compiler(
        "archiver",
        [*archiver, "rcs" if suffix == "dylib" else "rcsD", static, *objects],
        folder,
        static,
    )
    digest = hashlib.sha256((folder / linked).read_bytes()).hexdigest()
    library = f"lib{name}-{digest[:16]}.{suffix}"
    (folder / linked).rename(folder / library)
    for file in objects:
        (folder / file).unlink()
    return {
        "library": library,
        "sha256": digest,
        "static": static,
        "static_sha256": hashlib.sha256((folder / static).read_bytes()).hexdigest(),
        "compiler": compiler.version,
        "flags": list(compiler.flags),
        "identity": compiler.identity,
        "instruction_sets": list(compiler.instruction_sets),
    }


def _compile(
    stored: Objects,
    folder: Path,
    sources: Sequence[str],
    compiler: Compiler,
    flags_of: Callable[[str], Sequence[str]],
    log: Callable[[str], None],
    *,
    fresh: bool,
) -> None:
    """The object of each source, in the source's folder: from the cache ``stored`` unless
    ``fresh``, else compiled in parallel, the longest first.

    ``flags_of``: further flags of a source. After an error or Ctrl-C the compilers that run are
    ended.
    """
    missing = [file for file in sources if fresh or not stored.fetch(folder / file)]
    workers = max(2, os.cpu_count() or 1)
    tell = throttle(log)
    known = f", {len(sources) - len(missing)} known" * (len(missing) < len(sources))
    log(f"compiling {len(missing)} files{known}{expected_time(folder, missing, workers)}")
    programs = Programs()
    with ThreadPoolExecutor(max_workers=workers) as pool:
        jobs = {}
        try:
            for file in sorted(
                missing, key=lambda file: -_effort(folder, file)
            ):  # the longest first
                words = [
                    *compiler.command,
                    *compiler.flags,
                    *flags_of(file),
                    "-c",
                    file,
                    "-o",
                    _object(file),
                ]
                jobs[file] = pool.submit(
                    run_compiler, "C compiler", words, folder, _object(file), programs
                )
            for done, (file, job) in enumerate(jobs.items(), 1):
                job.result()
                stored.keep(folder / file)
                tell(f"compiled file {done} of {len(jobs)}: {file}")
        except BaseException:  # Ctrl-C too: what is left would be compiled to its end
            programs.stop()
            pool.shutdown(cancel_futures=True)
            raise


def _mathematics_of(source: Path) -> Path:
    """The header with the mathematics of a function, which only the sources of functions have; see
    `flexgen.codegen.emission.entry_points`.
    """
    return source.with_name(f"{source.stem}_math.h")


def _object(source: str) -> str:
    return str(Path(source).with_suffix(".o"))


def expected_time(folder: Path, sources: Sequence[str], workers: int) -> str:
    """``, about 2 min`` where compiling takes long; else an empty text."""
    efforts = [_effort(folder, source) for source in sources]
    seconds = SECONDS_PER_BYTE * max(max(efforts, default=0), sum(efforts) / workers)
    if seconds < LONG:
        return ""
    return f", about {seconds:.0f} s" if seconds < 100 else f", about {seconds / 60:.0f} min"


def _effort(folder: Path, source: str) -> int:
    """Bytes of a source, and of its mathematics, which it includes twice."""
    found = _mathematics_of(folder / source)
    size = (folder / source).stat().st_size
    return size + 2 * found.stat().st_size if found.exists() else size
