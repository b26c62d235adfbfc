"""From a model to a directory with its C library: written, compiled and described by
``manifest.json``.

A directory is complete or as it was before: everything is written and compiled aside, then moved
into place, the manifest last. The manifest holds the digest of all that the sources depend on and
the identity of the compiler that made the library; where both are unchanged nothing is done, where
the digest is nothing is derived.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flexgen.base.calls.deprecation import renamed
from flexgen.base.calls.progress import Choice, reported, throttle
from flexgen.base.checks.type_checks import checked_result, checked_types
from flexgen.base.checks.types_of_values import items_of
from flexgen.base.display import short_repr
from flexgen.base.errors import ArgumentError, BuildError
from flexgen.base.files.atomic_files import follow_links
from flexgen.base.results import Result
from flexgen.base.version import __version__
from flexgen.codegen.build.compiler import (
    NO_COMPILER,
    Compiler,
    IsaName,
    build_libraries,
    check_build,
    find_compiler,
)
from flexgen.codegen.build.directory import (
    MANIFEST,
    check_owned,
    clean,
    install,
    is_unchanged,
    libraries,
    read_manifest,
    staging,
)
from flexgen.codegen.build.packaging import packaging
from flexgen.codegen.build.source_digest import package_version, sources_digest
from flexgen.codegen.emission.amalgamation import merge_files
from flexgen.codegen.emission.c_functions import check_parts
from flexgen.codegen.emission.clib_types import signature_of
from flexgen.codegen.emission.digest import model_digest
from flexgen.codegen.emission.interface import ABI_VERSION, LIMITS, PARTS, STATUSES
from flexgen.codegen.emission.spec import (
    PRECISIONS,
    LibrarySpec,
    PrecisionName,
    choose_functions,
    library_name,
    library_spec,
)
from flexgen.model.elements import RobotModel
from flexgen.model.friction import added_sources
from flexgen.model.reader import read
from flexgen.runtime.identity import FORMAT
from flexgen.runtime.inversion.targets import TargetName

if TYPE_CHECKING:
    from flexgen.dynamics.mechanics.equations import Equations


@checked_result
@dataclass(frozen=True)
class GeneratedLibrary(Result):
    """Result of `generate`: the folder and its files.

    Parameters
    ----------
    directory : Path
        Where the library is; `flexgen.load` takes it.
    files : tuple of Path
        Everything in it: header, sources, CMake and pkg-config files, manifest, shared and static
        library.
    functions : tuple of str
        Names of the functions.
    digest : str
        SHA-256 of everything that the sources depend on.
    seconds : float
        Time taken [s].
    cached, written : bool
        Whether nothing had to be compiled or linked; whether anything had changed and was written.

    Examples
    --------
    >>> written = flexgen.generate("elbow", build=False)
    >>> print(written.directory, "inverse_dynamics" in written.functions)
    generated/elbow True
    """

    directory: Path
    files: tuple[Path, ...]
    functions: tuple[str, ...]
    digest: str
    seconds: float
    cached: bool
    written: bool

    __repr__ = short_repr


@renamed(model_or_equations="model")
@checked_types(own=("model", "directory", "parameters", "parts"))
@reported("generate")
def generate(
    model: str | Path | RobotModel | Equations,
    directory: str | os.PathLike[str] | None = None,
    *,
    build: bool = True,
    functions: Sequence[str] | None = None,
    precision: PrecisionName = "double",
    parameters: Sequence[str] = (),
    native: bool = False,
    openmp: bool = False,
    isa: IsaName = "native",
    target: TargetName | None = None,
    amalgamate: bool = False,
    per_point: bool = False,
    parts: Sequence[str] = (),
    progress: Choice = None,
    force: bool = False,
) -> GeneratedLibrary:
    """Write the C library of a model: header, sources, example, manifest, CMake and pkg-config
    files, libraries.

    Parameters
    ----------
    model : str, Path, RobotModel or Equations
        A name in models/, a path (either with ``@variant``), a model, or equations that were
        derived before.
    directory : str or Path, optional
        Where to write; ``generated/<name>`` (``<name>_<variant>``) below the current directory
        where not given.
    build : bool
        Compile the library; False: write the sources, do not compile.
    functions : sequence of str, optional
        Only these functions of the list below, without inversion of whole paths; default: all.
        Inverse dynamics along paths and streams come with all of them.
    precision : str
        Of the numbers in C.
    parameters : sequence of str
        Model parameters that become arguments of the functions: ``payload``, ``stiffness``,
        ``damping``, ``friction``, ``q2.stiffness``, ... See
        `flexgen.dynamics.mechanics.parameters`. Equations that are given bring their own.
    native : bool
        Contract products and sums: a little faster, results differ by rounding.
    openmp : bool
        Batch functions use all cores.
    isa : str
        Instruction set of the compiled libraries, same results for each: ``native`` (this
        processor, the default), ``x86-64``, v2, v3 (AVX2) or v4 (AVX-512) for other computers. In
        Python ``"x86-64-v2"`` to ``"x86-64-v4"``.
    target : str, optional
        Compile with the package ziglang for another kind of computer, with the same results. Both
        of Linux with glibc 2.17 or newer.
    amalgamate : bool
        Write one header and one C file. ``<name>.h`` and ``<name>.c`` instead of many files; the
        results have the same bits.
    per_point : bool
        True: batches take parameters for each point, not one vector for all; no inversion along
        paths, no streams.
    parts : sequence of str
        Optional parts: ``bvp``, another method for whole paths, to check invert; ``derivatives``:
        products with derivatives of the functions, for JAX and PyTorch; ``force``: a force on the
        tool along paths; ``limits``: limits of gears, springs, joints and tool in streams;
        ``position``: positions to send to the servo of the model file. Derivatives are
        ``NAME_jvp``, ``_vjp``.
    progress : callable or bool, optional
        As for `flexgen.solve`.
    force : bool
        Build even if nothing has changed.

    Returns
    -------
    GeneratedLibrary

    Raises
    ------
    BuildError
        C cannot express it, a compiler is missing or fails, or the directory, which stays, cannot
        take the library.
    ModelError, ArgumentError
        Where the model cannot be read or a function is unknown.

    Examples
    --------
    >>> written = flexgen.generate("elbow", build=False)
    >>> print(written.directory, "inverse_dynamics" in written.functions)
    generated/elbow True
    """
    start = time.perf_counter()
    log = progress if callable(progress) else (lambda line: None)
    robot, equations = _resolve(model)
    options = check_build(bool(native), bool(openmp), isa, target)
    parts = tuple(dict.fromkeys(_names("parts", parts)))
    names = choose_functions(functions, robot, parts)
    _check_choices(precision, parameters, equations)
    check_parts(parts, robot, names, precision)
    folder = _folder(Path("generated", library_name(robot)) if directory is None else directory)
    request = _Request(
        robot,
        equations,
        names,
        precision,
        tuple(parameters),
        bool(amalgamate),
        bool(per_point),
        options,
        force,
        parts,
    )
    return _generate_folder(request, folder, build, log, start)


def generate_parts(
    model: RobotModel,
    directory: Path,
    functions: Sequence[str],
    solvers: Sequence[str],
    *,
    parameters: Sequence[str] = (),
    per_point: bool = False,
    native: bool = False,
    progress: Callable[[str], None],
) -> GeneratedLibrary:
    """`generate` for flexgen itself, which compiles only the functions that it calls.

    Parameters
    ----------
    model : RobotModel
    directory : Path
    functions : sequence of str
        Names of emitted functions.
    solvers : sequence of str
        Names of the hand-written sources: ``invert``, ``bvp``, ``stream`` and others.
    parameters, per_point, native, progress
        See `generate`.
    """
    options = {"native": native, "openmp": False, "isa": "native", "target": None}
    names = choose_functions(functions, model)
    parts = tuple(part for part in PARTS if part in solvers)
    request = _Request(
        model,
        None,
        names,
        "double",
        tuple(parameters),
        False,
        per_point,
        options,
        False,
        parts,
        solvers,
    )
    return _generate_folder(request, directory, True, progress, time.perf_counter())


@dataclass(frozen=True)
class _Request:
    """Inputs from which a library is generated.

    ``equations``: None to derive them; ``options``: of the build; ``parts``: optional hand-written
    sources; ``solvers``: None for all hand-written sources.
    """

    model: RobotModel
    equations: Any
    names: tuple[str, ...]
    precision: str
    parameters: tuple[str, ...]
    amalgamate: bool
    per_point: bool
    options: dict[str, Any]
    force: bool
    parts: tuple[str, ...]
    solvers: Sequence[str] | None = None


def _generate_folder(
    request: _Request, target: Path, build: bool, log: Callable[[str], None], start: float
) -> GeneratedLibrary:
    """The library in the folder ``target``: the existing one where nothing has changed, else
    written and compiled.
    """
    name = library_name(request.model)
    options = request.options
    follow_links(target)
    clean(target)
    digest = _content_digest(request)
    compiler = find_compiler(**options) if build else None
    old = read_manifest(target, name)
    known = (
        not request.force
        and old is not None
        and old.get("digest") == digest
        and _intact(target, old)
    )
    if known and old is not None and (not build or _built(target, old, options, compiler)):
        return _result(target, old, start, cached=True, written=False)
    if build and compiler is None:
        raise BuildError(
            f"{NO_COMPILER}, or write the sources only: build=False in Python, --no-build on "
            "the command line"
        )
    if known and old is not None:
        manifest = dict(old)
        texts = {file: (target / file).read_text(encoding="ascii") for file in old["files"]}
    else:
        manifest, texts = _write_sources(request, digest, log)
    public = [file for file in texts if file.endswith(".h") and "/" not in file]
    texts |= packaging(name, _sources(texts), public, openmp=options["openmp"])
    manifest["files"] = {
        file: hashlib.sha256(text.encode("ascii")).hexdigest() for file, text in texts.items()
    }
    manifest["build"] = None
    if (
        not request.force
        and old is not None
        and old["files"] == manifest["files"]
        and _intact(target, old)
    ):
        manifest["build"] = (
            old["build"] if not build or _built(target, old, options, compiler) else None
        )
    check_owned(target, name, texts, old)
    compiled = manifest["build"] is None and compiler is not None
    with staging(target) as folder:
        _write(folder, texts)
        if compiled and compiler is not None:
            headers = [file for file in texts if file.endswith(".h")]
            built = build_libraries(
                folder, name, _sources(texts), headers, compiler, log, fresh=request.force
            )
            manifest["build"] = options | built
        install(folder, target, manifest, old)
    return _result(target, manifest, start, cached=not compiled, written=True)


def _check_choices(precision: str, parameters: Sequence[str], equations: Any) -> None:
    """ArgumentError for a choice that is not offered."""
    if precision not in PRECISIONS:
        raise ArgumentError(
            f"precision: given {precision!r}, expected one of {', '.join(PRECISIONS)}"
        )
    _names("parameters", parameters)
    if parameters and equations is not None:
        raise ArgumentError(
            "parameters: given together with equations, expected them in derive(model, parameters)"
        )


def _names(argument: str, given: Any) -> list[Any]:
    """An argument that is a sequence of names; ArgumentError where it is not."""
    names = items_of(given)
    if names is None or not all(isinstance(word, str) for word in names):
        raise ArgumentError(f"{argument}: given {given!r}, expected a sequence of names")
    return list(names)


def _sources(texts: Mapping[str, str]) -> list[str]:
    """The files that the library is compiled from."""
    return [file for file in texts if file.endswith(".c") and file != "example.c"]


def _write(folder: Path, texts: Mapping[str, str]) -> None:
    """Write the texts to the folder."""
    for file, text in texts.items():
        (folder / file).parent.mkdir(exist_ok=True)
        (folder / file).write_text(text, encoding="ascii", newline="\n")


def _write_sources(
    request: _Request, digest: str, log: Callable[[str], None]
) -> tuple[dict[str, Any], dict[str, str]]:
    """The manifest and the text of each source by name; equations are derived where the request
    has none. ``digest``: goes into the manifest.
    """
    name = library_name(request.model)
    equations = request.equations
    if equations is None:
        from flexgen.dynamics.mechanics.equations import derive

        log(f"deriving {name}")
        equations = derive(request.model, request.parameters)
    log(f"writing {name}")
    from flexgen.codegen.emission.emit import emit, function_texts, inversion_header

    spec = offered = library_spec(
        equations,
        request.names,
        precision=request.precision,
        per_point=request.per_point,
        parts=request.parts,
    )
    if request.solvers is not None:
        wanted = {f"{solver}.c" for solver in request.solvers}
        spec = replace(spec, c_functions=tuple(f for f in spec.c_functions if f.file in wanted))
    elif spec.inverts:
        from flexgen.codegen.build.stream_defaults import with_defaults

        spec = with_defaults(request.model, spec)
    written = function_texts(spec, throttle(log))
    texts = emit(spec, written)
    if request.solvers is not None and spec.inverts:
        # one header, so that other choices of solvers take the same objects
        texts[f"{name}_inversion.h"] = inversion_header(offered, written)
    texts = merge_files(name, texts) if request.amalgamate else texts
    return _manifest(spec, digest, {f: text.work > 0 for f, text in written.items()}), texts


def _resolve(given: Any) -> tuple[RobotModel, Any]:
    """The model, and the equations where they were given."""
    if isinstance(given, str | os.PathLike):
        given = read(given if isinstance(given, str) else Path(given))
    derived = isinstance(getattr(given, "model", None), RobotModel) and callable(
        getattr(given, "function", None)
    )
    if not derived and not isinstance(given, RobotModel):
        raise ArgumentError(
            f"model: given {type(given).__name__}, expected a name or path, a RobotModel or "
            "Equations"
        )
    robot = given.model if derived else given
    return robot, given if derived else None


def _folder(given: Any) -> Path:
    """The directory to write to."""
    if (
        not isinstance(given, str | os.PathLike)
        or not isinstance(os.fspath(given), str)
        or "\0" in os.fspath(given)
    ):
        raise ArgumentError(f"directory: given {given!r}, expected the path of a folder")
    return Path(given)


# --- digest and manifest -------------------------------------------------------------------------


def _content_digest(request: _Request) -> str:
    """SHA-256 of all that the sources depend on, known without deriving them.

    Equations that a caller brings may differ from those of `derive`: they never share a digest,
    and the emitted text decides whether there is something to compile.
    """
    own = request.equations is not None
    choices = [
        request.names,
        request.precision,
        list(request.parameters),
        own,
        request.amalgamate,
        request.per_point,
    ]
    choices += [list(request.parts), *([] if request.solvers is None else [list(request.solvers)])]
    added = [source.read_bytes() for source in added_sources(request.model)]
    parts = [
        FORMAT,
        ABI_VERSION,
        model_digest(request.model),
        __version__,
        sources_digest(),
        hashlib.sha256(b"".join(added)).hexdigest(),
        *choices,
    ]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def _manifest(spec: LibrarySpec, digest: str, needs_work: Mapping[str, bool]) -> dict[str, Any]:
    """Description of the library for the Python loader and other tools, before files and build are
    known.

    ``digest``: of all that the sources depend on; ``needs_work``: of each function whether it
    takes a workspace.
    """
    return {
        "format": FORMAT,
        "generator": f"flexgen {__version__}",
        "casadi": package_version("casadi"),
        "name": spec.name,
        "digest": digest,
        "model_digest": spec.digest,
        "abi_version": ABI_VERSION,
        "precision": spec.precision,
        "sizes": spec.sizes,
        "coordinates": [
            {"name": name, "unit": unit}
            for name, unit in zip(spec.coordinates, spec.coordinate_units, strict=True)
        ],
        "motors": list(spec.motors),
        "states": list(spec.states),
        "per_point": spec.per_point,
        "parameters": [asdict(parameter) for parameter in spec.parameters],
        "statuses": [asdict(status) for status in STATUSES],
        "functions": [
            {
                "name": f.name,
                "work": needs_work[f.name],
                "summary": f.summary,
                "equation": f.equation,
                "inputs": [{**asdict(p), "shape": list(p.shape)} for p in f.inputs],
                "outputs": [{**asdict(p), "shape": list(p.shape)} for p in f.outputs],
            }
            for f in spec.functions
        ],
        "structs": [
            {
                "name": struct.name,
                "signature": signature_of(struct),
                "fields": [asdict(f) for f in struct.fields],
            }
            for struct in spec.structs
        ],
        "enums": {enum.name: enum.names for enum in spec.enums},
        "limits": {limit.name: limit.value for limit in LIMITS},
        "c_functions": [{**asdict(f), "signature": f.signature} for f in spec.c_functions],
        "files": {},
        "build": None,
    }


def _intact(directory: Path, manifest: dict[str, Any]) -> bool:
    """True where every text is there as recorded."""
    return is_unchanged(directory, manifest["files"])


def _built(
    directory: Path, manifest: dict[str, Any], options: dict[str, Any], compiler: Compiler | None
) -> bool:
    """True where the libraries are there with the digests that ``manifest`` records, made with
    these ``options`` by this compiler (None: any).
    """
    built: Any = manifest.get("build")
    try:
        made_so = {key: built[key] for key in options} == options
        if not made_so or (compiler is not None and built["identity"] != compiler.identity):
            return False
        return is_unchanged(
            directory, {built["library"]: built["sha256"], built["static"]: built["static_sha256"]}
        )
    except (KeyError, TypeError):
        return False


def _result(
    directory: Path, manifest: dict[str, Any], start: float, *, cached: bool, written: bool
) -> GeneratedLibrary:
    """The result of `generate`, with the time since ``start`` [s]; ``cached``: nothing was
    compiled; ``written``: files were.
    """
    return GeneratedLibrary(
        directory=directory,
        files=tuple(
            directory / file for file in (*manifest["files"], MANIFEST, *libraries(manifest))
        ),
        functions=tuple(f["name"] for f in manifest["functions"]),
        digest=manifest["digest"],
        seconds=time.perf_counter() - start,
        cached=cached,
        written=written,
    )
