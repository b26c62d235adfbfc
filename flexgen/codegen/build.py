"""From a model to a directory with its C library: written, compiled and described by ``manifest.json``.

A directory is complete or as it was before: everything is written and compiled aside, then moved into place, the
manifest last. The manifest holds the digest of all that the library depends on; where it is unchanged nothing is done.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from flexgen import __version__
from flexgen.codegen.spec import (
    ABI_VERSION,
    STATUSES,
    LibrarySpec,
    chosen_functions,
    library_name,
    library_spec,
    model_digest,
)
from flexgen.errors import ArgumentError, BuildError
from flexgen.model.elements import RobotModel
from flexgen.model.reader import read

MANIFEST = "manifest.json"
FORMAT = 1
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-fvisibility=hidden")
WORKERS = 2

_COMPILERS = ("cc", "gcc", "clang")
_ALLOWED_FLAG = re.compile(r"-(O[0-3]|g|pipe|m32|m64|m(arch|tune)=[a-z0-9.-]+|ffp-contract=(off|on|fast))\Z")
_FILE = re.compile(r"[A-Za-z][A-Za-z0-9_]*(-[0-9a-f]{16})?\.(h|c|so|dylib)\Z")


@dataclass(frozen=True)
class Generated:
    """What `generate` left behind.

    Parameters
    ----------
    directory : Path
        Where the library is; `flexgen.load` takes it.
    files : tuple of Path
        Everything in it: header, sources, manifest, shared library.
    functions : tuple of str
        Names of the functions.
    digest : str
        SHA-256 of everything that the library depends on.
    seconds : float
        Time taken [s].
    cached : bool
        True where nothing had to be compiled.
    written : bool
        False where nothing had changed, so that nothing was written either.
    """

    directory: Path
    files: tuple[Path, ...]
    functions: tuple[str, ...]
    digest: str
    seconds: float
    cached: bool
    written: bool


@dataclass(frozen=True)
class _Compiler:
    """A C compiler: the words of its command and the first line of what it says of its version."""

    command: tuple[str, ...]
    version: str


def generate(
    model_or_equations: Any,
    directory: str | os.PathLike[str] | None = None,
    *,
    build: bool = True,
    functions: Sequence[str] | None = None,
    progress: Callable[[str], None] | None = None,
    force: bool = False,
) -> Generated:
    """Write the C library of a model: header, sources, example, manifest and a shared library.

    Parameters
    ----------
    model_or_equations : str, Path, RobotModel or Equations
        A name in models/, a path (either with ``@variant``), a model, or equations that were derived before.
    directory : str or Path, optional
        Where to write; ``generated/<name>`` (``<name>_<variant>``) below the current directory where not given.
    build : bool
        False: write the sources, compile nothing.
    functions : sequence of str, optional
        The functions wanted; all of them where not given.
    progress : callable, optional
        Called with a line of text before each step.
    force : bool
        True: derive, write and compile even where nothing has changed.

    Returns
    -------
    Generated

    Raises
    ------
    BuildError
        Where something cannot be written in C, or the compiler is missing or fails; the directory stays as it was.
    ModelError, ArgumentError
        Where the model cannot be read or a function is unknown.
    """
    start = time.perf_counter()
    tell = progress or (lambda line: None)
    model, equations = _resolve(model_or_equations)
    names = chosen_functions(functions)
    name = library_name(model)
    target = Path("generated", name) if directory is None else _folder(directory)
    digest = _content_digest(model, names, given_equations=equations is not None)
    compiler = _find_compiler()
    old = _read_manifest(target)
    if not force and old is not None and old.get("digest") == digest and _intact(target, old, build, compiler):
        return _result(target, old, start, cached=True, written=False)
    if build and compiler is None:
        raise BuildError(
            "C compiler: given none, expected cc, gcc or clang on the PATH or $CC; "
            "install one (such as the package gcc or build-essential), or write the sources only: "
            "build=False in Python, --no-build on the command line"
        )
    if equations is None:
        from flexgen.mechanics.equations import derive

        tell(f"deriving {name}")
        equations = derive(model)
    tell(f"writing {name}")
    from flexgen.codegen.emit import emit

    spec = library_spec(equations, names)
    texts = emit(spec)
    manifest = _manifest(spec, texts, digest)
    same = not force and old is not None and old.get("files") == manifest["files"]
    if same and old is not None and _intact(target, old, build, compiler):
        manifest["build"] = old.get("build")
    with _Staging(target) as staging:
        for file, text in texts.items():
            (staging / file).write_text(text, encoding="ascii", newline="\n")
        compiled = build and manifest["build"] is None and compiler is not None
        if compiled and compiler is not None:
            sources = [file for file in texts if file.endswith(".c") and file != "example.c"]
            manifest["build"] = _compile(staging, spec.name, sources, compiler, tell)
        _install(staging, target, manifest, old)
    return _result(target, manifest, start, cached=not compiled, written=True)


def _resolve(given: Any) -> tuple[RobotModel, Any]:
    """The model, and the equations where they were given."""
    if isinstance(given, RobotModel):
        return given, None
    if isinstance(given, str | os.PathLike):
        return read(given if isinstance(given, str) else Path(given)), None
    if isinstance(getattr(given, "model", None), RobotModel) and callable(getattr(given, "function", None)):
        return given.model, given
    raise ArgumentError(
        f"model_or_equations: given {type(given).__name__}, expected a model's name or path, a RobotModel or Equations"
    )


def _folder(given: Any) -> Path:
    """The directory to write to."""
    if not isinstance(given, str | os.PathLike) or not isinstance(os.fspath(given), str) or "\0" in os.fspath(given):
        raise ArgumentError(f"directory: given {given!r}, expected the path of a folder")
    return Path(given)


# --- digest and manifest ----------------------------------------------------------------------------------------------


def _content_digest(model: RobotModel, names: tuple[str, ...], *, given_equations: bool) -> str:
    """SHA-256 of all that the library depends on, known without deriving it.

    Equations that a caller brings may differ from those of `derive`: they never share a digest, and the emitted text
    decides whether there is something to compile.
    """
    root = Path(__file__).resolve().parent.parent
    sources = [root / "ports.py", root / "model" / "elements.py"]
    for folder in ("codegen", "mechanics"):
        sources += sorted((root / folder).glob("*.py"))
    code = hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()
    parts = [FORMAT, ABI_VERSION, model_digest(model), __version__, _casadi_version(), code, names, FLAGS]
    return hashlib.sha256(json.dumps([*parts, given_equations]).encode()).hexdigest()


def _casadi_version() -> str:
    """Version of CasADi, found without importing it."""
    try:
        return version("casadi")
    except PackageNotFoundError:
        return "unknown"


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _manifest(spec: LibrarySpec, texts: dict[str, str], digest: str) -> dict[str, Any]:
    """What the Python loader and other tools need to know of the library."""
    return {
        "format": FORMAT,
        "generator": f"flexgen {__version__}",
        "casadi": _casadi_version(),
        "name": spec.name,
        "digest": digest,
        "model_digest": spec.digest,
        "abi_version": ABI_VERSION,
        "sizes": spec.sizes,
        "coordinates": [
            {"name": name, "unit": unit} for name, unit in zip(spec.coordinates, spec.coordinate_units, strict=True)
        ],
        "motors": list(spec.motors),
        "states": list(spec.states),
        "statuses": [asdict(status) for status in STATUSES],
        "functions": [
            {
                "name": f.name,
                "summary": f.summary,
                "equation": f.equation,
                "inputs": [{**asdict(p), "shape": list(p.shape)} for p in f.inputs],
                "outputs": [{**asdict(p), "shape": list(p.shape)} for p in f.outputs],
            }
            for f in spec.functions
        ],
        "files": {file: hashlib.sha256(text.encode("ascii")).hexdigest() for file, text in texts.items()},
        "build": None,
    }


def _read_manifest(directory: Path) -> dict[str, Any] | None:
    """The manifest of a directory, or None where there is none that can be read."""
    try:
        manifest = json.loads((directory / MANIFEST).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return manifest if isinstance(manifest, dict) and isinstance(manifest.get("files"), dict) else None


def _intact(directory: Path, manifest: dict[str, Any], build: bool, compiler: _Compiler | None) -> bool:
    """True where every file is there as recorded and, where asked for, the library as this compiler makes it."""
    files = dict(manifest["files"])
    built = manifest.get("build")
    if build and built is None:
        return False
    try:
        if built is not None:
            if compiler is not None and [built["compiler"], built["flags"]] != [compiler.version, _flags(compiler)]:
                return False
            files[built["library"]] = built["sha256"]
        return all(_FILE.match(file) and _sha256(directory / file) == digest for file, digest in files.items())
    except (OSError, KeyError, TypeError):
        return False


def _result(directory: Path, manifest: dict[str, Any], start: float, *, cached: bool, written: bool) -> Generated:
    files = [*manifest["files"], MANIFEST, *([manifest["build"]["library"]] if manifest["build"] else [])]
    return Generated(
        directory=directory,
        files=tuple(directory / file for file in files),
        functions=tuple(f["name"] for f in manifest["functions"]),
        digest=manifest["digest"],
        seconds=time.perf_counter() - start,
        cached=cached,
        written=written,
    )


# --- moving into place ------------------------------------------------------------------------------------------------


class _Staging:
    """A temporary folder inside the directory to be written; with it goes a directory that it had to create."""

    def __init__(self, target: Path) -> None:
        self.target = target
        self.created = not target.exists()

    def __enter__(self) -> Path:
        try:
            self.target.mkdir(parents=True, exist_ok=True)
            self.folder = Path(tempfile.mkdtemp(prefix=".staging-", dir=self.target))
        except OSError as error:
            raise BuildError(f"directory: given {self.target}, expected one that can be written ({error})") from error
        return self.folder

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)
        if kind is not None and self.created and not any(self.target.iterdir()):
            self.target.rmdir()


def _install(staging: Path, target: Path, manifest: dict[str, Any], old: dict[str, Any] | None) -> None:
    """Move everything into place, the manifest last, then remove what the last generation left over."""
    (staging / MANIFEST).write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8", newline="\n")
    library = manifest["build"]["library"] if manifest["build"] else None
    for file in [*manifest["files"], *([library] if library and (staging / library).exists() else []), MANIFEST]:
        os.replace(staging / file, target / file)
    kept = {*manifest["files"], library}
    stale = [target / file for file in (old or {}).get("files", ()) if _FILE.match(file) and file not in kept]
    stale += [path for path in target.glob(f"lib{manifest['name']}-*") if path.name not in kept]
    for path in stale:
        if _FILE.match(path.name):
            path.unlink(missing_ok=True)


# --- compiler ---------------------------------------------------------------------------------------------------------


def _find_compiler() -> _Compiler | None:
    """The compiler of $CC, or else the first of cc, gcc and clang; None where there is none."""
    given = os.environ.get("CC", "")
    try:
        chosen = shlex.split(given)
    except ValueError as error:
        raise BuildError(f"$CC: given {given!r}, expected a command ({str(error).lower()})") from None
    if chosen:
        for word in chosen:
            if word.startswith("-") and not _ALLOWED_FLAG.match(word):
                raise BuildError(f"$CC: given the flag {word!r}, expected optimisation, -m32, -m64 or -march=... only")
            if not word.startswith("-") and shutil.which(word) is None:
                raise BuildError(f"$CC: given {word!r}, expected a program that can be found; unset CC or install it")
    else:
        found = next((name for name in _COMPILERS if shutil.which(name)), None)
        if found is None:
            return None
        chosen = [found]
    try:
        answer = subprocess.run([*chosen, "--version"], capture_output=True, text=True, errors="replace", check=False)
    except OSError as error:
        raise BuildError(f"C compiler: given {chosen[0]!r}, which cannot be run ({error.strerror})") from None
    return _Compiler(tuple(chosen), answer.stdout.strip().partition("\n")[0])


def _flags(compiler: _Compiler) -> list[str]:
    return [*(word for word in compiler.command[1:] if word.startswith("-")), *FLAGS]


def _run(command: Sequence[str], folder: Path) -> None:
    """Run the compiler; BuildError with its first error lines where it fails."""
    answer = subprocess.run(list(command), cwd=folder, capture_output=True, text=True, errors="replace", check=False)
    if answer.returncode != 0:
        lines = [line for line in answer.stderr.splitlines() if line.strip()]
        errors = [line for line in lines if "error" in line.lower()] or lines
        told = "\n  ".join(errors[:5]) or f"exit status {answer.returncode}, without a word"
        raise BuildError(f"the C compiler failed; the directory is as it was before:\n  {told}")


def _compile(
    folder: Path, name: str, sources: Sequence[str], compiler: _Compiler, tell: Callable[[str], None]
) -> dict[str, Any]:
    """Compile and link the sources in a folder; the part of the manifest that describes the library."""
    tell(f"compiling {len(sources)} files")
    largest_first = sorted(sources, key=lambda file: -(folder / file).stat().st_size)
    objects = [str(Path(file).with_suffix(".o")) for file in sources]
    with ThreadPoolExecutor(max_workers=WORKERS) as pool:
        jobs = [
            pool.submit(_run, [*compiler.command, *FLAGS, "-c", file, "-o", str(Path(file).with_suffix(".o"))], folder)
            for file in largest_first
        ]
        try:
            for job in jobs:
                job.result()
        except BuildError:
            pool.shutdown(cancel_futures=True)
            raise
    tell("linking")
    suffix = "dylib" if sys.platform == "darwin" else "so"
    linked = folder / f"linked.{suffix}"
    _run([*compiler.command, *FLAGS, "-shared", "-o", linked.name, *objects, "-lm"], folder)
    digest = _sha256(linked)
    library = f"lib{name}-{digest[:16]}.{suffix}"
    linked.rename(folder / library)
    return {"library": library, "sha256": digest, "compiler": compiler.version, "flags": _flags(compiler)}
