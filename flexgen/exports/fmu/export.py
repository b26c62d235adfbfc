"""A robot as a Functional Mock-up Unit: sources, binary and description in one file with
reproducible bytes.
"""

from __future__ import annotations

import hashlib
import os
import re
import time
import zipfile
from collections.abc import Callable, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from flexgen.base.calls.progress import Choice, reported
from flexgen.base.checks.bounds import Bound
from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import ArgumentError, BuildError
from flexgen.base.files.atomic_files import atomic_file
from flexgen.base.version import __version__
from flexgen.codegen.emission.clib_files import keep_parts
from flexgen.exports.exported import Exported, exported, left_out
from flexgen.exports.fmu.binaries import SOURCE, Binary, binaries_of, compile_binary
from flexgen.exports.fmu.block import FASTEST, Block, config
from flexgen.exports.fmu.description import build_description, description_2, description_3
from flexgen.model.elements import RobotModel
from flexgen.model.reader import read
from flexgen.simulation.integration.hold import SAMPLE_TIME

FmiVersion = Literal["2.0", "3.0"]
VERSIONS: tuple[FmiVersion, ...] = get_args(FmiVersion)
BlockName = Literal["plant", "feedforward", "controller"]
BLOCKS: tuple[BlockName, ...] = get_args(BlockName)
Step = Annotated[float, Bound(1e-9, 1e3, words="a time between 1e-9 and 1000 s")]
_FOLDER = Path(__file__).parent
# of all files that are the same for every model, and of the configuration
_PREFIX = "flexgen_fmu_"
_FIXED = {
    "FMU_PLANT": "plant.h",
    "FMU_FEEDFORWARD": "feedforward.h",
    "FMU_CONTROLLER": "controller.h",
}
_OF_BLOCK = {
    "method": "plant",
    "step": "plant",
    "controller": "controller",
    "sample_time": "controller",
    "look_ahead": "feedforward",
}
_INCLUDE = re.compile(r'\s*#\s*include "([^"]+)"')
_MACRO = re.compile(r"^\s*#\s*define (\w+)", re.MULTILINE)
_WORD = re.compile(r"[A-Za-z_]\w*")
_LICENSE = (
    "flexgen: MIT. fmi2*.h and fmi3*.h: Modelica Association, 2-clause BSD, see these files.\n"
)


@checked_types
@reported("export_fmu")
def export_fmu(
    model: str | Path | RobotModel,
    path: str | os.PathLike[str] | None = None,
    *,
    version: FmiVersion = "2.0",
    block: BlockName = "plant",
    binary: bool = True,
    platforms: str | Sequence[str] | None = None,
    method: Literal["rk4", "sdirk4"] | None = None,
    step: Step | None = None,
    controller: Any = None,
    sample_time: Step | None = None,
    look_ahead: Step | None = None,
    progress: Choice = None,
) -> Exported:
    """Write a Functional Mock-up Unit (FMU): a robot, its feedforward or a controller, for other
    simulation programs.

    It has both interfaces, Model Exchange and Co-Simulation, sources in C99 and a binary for this
    platform. The same arguments and compiler give the same bytes. Several instances may run at the
    same time, each in its own thread.

    Parameters
    ----------
    model : str, Path or RobotModel
        A name in models/, a path (either with ``@variant``), or a model.
    path : str or Path, optional
        Where to write; default: ``generated/<name>.fmu``, with ``_feedforward`` or ``_controller``
        behind the name.
    version : str
        Version of FMI: ``"2.0"`` (default) or ``"3.0"``.
    block : str
        ``"plant"`` (default): the elastic robot; ``"feedforward"``: inverse dynamics on a moving
        horizon; ``"controller"``: a P-PI cascade. Plant: motor torques and tool forces in, motor
        angles, tool pose and deflections out. Feedforward: path samples in, torques and references
        out. Controller: measured angles and references in, motor torques out.
    binary : bool
        With a binary. False: without a binary. Sources need no compiler here.
    platforms : str or sequence of str, optional
        Compile binaries for these platforms with the package ziglang: all, or names of FMI such as
        win64, linux64, darwin64, aarch64-linux; default: this platform. Also ``"aarch64-darwin"``
        (or ``"x86_64-windows"``, ... of FMI 3.0); that of this platform by the compiler that is
        here.
    method : str, optional
        Plant in Co-Simulation: ``"rk4"`` (default), explicit, or ``"sdirk4"``, implicit and
        L-stable, for stiff springs. Both of order 4; ``integration.method`` changes it before a
        simulation.
    step : float, optional [s]
        Its largest step; default: from the fastest pole at home. A communication step is divided
        into equal steps that are not longer.
    controller : Cascade, PPI, str or Path, optional
        Of type ppi or cascade (.toml); default: PPI for the model. For the block ``"controller"``.
        It gets its gains at the home pose, with one sample time of delay.
    sample_time : float, optional [s]
        Sample time of the controller; default: 0.001.
    look_ahead : float, optional [s]
        Horizon of the feedforward; default: from the unstable zeros. From a path sample to the
        output that reaches it, as in the generated library.
    progress : bool or callable, optional
        As for `flexgen.solve`.

    Returns
    -------
    Exported

    Raises
    ------
    ArgumentError
        An argument is out of range or of another block, or the model has no inverse dynamics for
        the feedforward.
    BuildError
        There is no C compiler, or it fails, or the name of the model is taken in C; nothing is
        written then.
    ModelError
        The model cannot be read.

    Examples
    --------
    >>> written = flexgen.export_fmu("elbow", "elbow.fmu", binary=False)
    >>> written.details["version"]
    '2.0'

    Source: Functional Mock-up Interface for Model Exchange and Co-Simulation, 2.0.5 and 3.0.2,
    Modelica Association.
    """
    given = dict(
        method=method,
        step=step,
        controller=controller,
        sample_time=sample_time,
        look_ahead=look_ahead,
    )
    _check(version, block, path, given)
    log = progress if callable(progress) else lambda line: None
    binaries = binaries_of(version, binary, platforms)
    robot = model if isinstance(model, RobotModel) else read(model)
    return _written(robot, path, (version, block, binaries), given, log)


def _written(
    robot: RobotModel,
    path: str | os.PathLike[str] | None,
    what: tuple[str, str, tuple[Binary, ...]],
    given: Mapping[str, Any],
    log: Callable[[str], None],
) -> Exported:
    """Write the FMU; ``what``: the version of FMI, the block, and the binaries."""
    began = time.perf_counter()
    (version, block, binaries) = what
    log(f"deriving {robot.name}")
    made = _block(robot, block, given)
    target = Path("generated", f"{made.name}.fmu") if path is None else Path(path)
    content, token = _content(made, version, binaries, log)
    with atomic_file(target) as out:
        out.write(content)
    where = ", ".join(binary.platform for binary in binaries) or None
    inside = (
        "sources only"
        if where is None
        else f"{'binary' if len(binaries) == 1 else 'binaries'} for {where}"
    )
    text = f"FMI {version}, {block}, Model Exchange and Co-Simulation, {inside}"
    details: dict[str, Any] = dict(
        block=block, version=version, token=token, binary=where, variables=made.variables
    )
    details["seconds"] = time.perf_counter() - began
    notes = left_out(robot) if block == "plant" else ()
    return exported(robot, "fmu", (target,), (text,), notes=notes, details=details)


def _content(
    block: Block, version: str, binaries: Sequence[Binary], log: Callable[[str], None]
) -> tuple[bytes, str]:
    """The file and its token."""
    texts, token = texts_of(block, version)
    files = {name: text.encode() for name, text in texts.items()}
    for binary in binaries:
        log(f"compiling {block.name} for {binary.platform}")
        made = compile_binary(block, texts, binary.compiler)
        files[f"binaries/{binary.platform}/{block.name}.{binary.compiler.suffix}"] = made
    return _zip(files), token


def _check(version: str, block: str, path: Any, given: Mapping[str, Any]) -> None:
    """Refuse arguments of `export_fmu` that are not a version, block or method, options of another
    block, and a path that does not end in .fmu.
    """
    method = "rk4" if given["method"] is None else given["method"]
    for name, value, expected in (
        ("version", version, VERSIONS),
        ("block", block, BLOCKS),
        ("method", method, ("rk4", "sdirk4")),
    ):
        if value not in expected:
            raise ArgumentError(f"{name}: given {value!r}, expected one of {', '.join(expected)}")
    for name, of in _OF_BLOCK.items():
        if given[name] is not None and block != of:
            raise ArgumentError(
                f"{name}: given one for the block {block!r}, expected it with block={of!r} only"
            )
    if path is not None and not (
        isinstance(path, str | os.PathLike) and Path(path).suffix == ".fmu"
    ):
        shown = os.fspath(path) if isinstance(path, os.PathLike) else path
        raise ArgumentError(
            f"path: given {shown!r}, expected the path of a file that ends in .fmu"
        )


def _block(model: RobotModel, block: str, given: Mapping[str, Any]) -> Block:
    """The block by its name, with the options ``given``; its module is imported here."""
    if block == "plant":
        from flexgen.exports.fmu.plant import plant

        return plant(model, given["method"] or "rk4", given["step"])
    if block == "feedforward":
        from flexgen.exports.fmu.feedforward import feedforward

        return feedforward(model, given["look_ahead"])
    from flexgen.exports.fmu.controller import controller as cascade

    return cascade(
        model,
        given["controller"],
        SAMPLE_TIME if given["sample_time"] is None else given["sample_time"],
    )


def texts_of(block: Block, version: str) -> tuple[dict[str, str], str]:
    """All text files of the FMU by name, and the token."""
    interface = _interface(version)
    headers = sorted(path.name for path in (_FOLDER / "standard").glob(f"fmi{version[0]}*.h"))
    own = [interface, *(_PREFIX + name for name in ("core.h", "warnings.h", _FIXED[block.macro]))]
    made_by = {"POSITION": "N_C", "MEMORY": FASTEST}
    parts = [part for part, name in made_by.items() if name in block.defines]
    texts = {
        name: keep_parts((_FOLDER / "c" / name).read_text(encoding="ascii"), parts) for name in own
    }
    texts |= {name: (_FOLDER / "standard" / name).read_text(encoding="ascii") for name in headers}
    _check_name(block, texts)
    top = f'#include "{_PREFIX}warnings.h"\n\n'
    texts |= {name: top * name.endswith(".c") + text for name, text in block.sources.items()}

    def describe(token: str) -> str:
        return (
            description_2(block, token, [SOURCE])
            if version == "2.0"
            else description_3(block, token)
        )

    hashed = [
        __version__,
        describe(""),
        config(block, ""),
        *(f"{name}\n{texts[name]}" for name in sorted(texts)),
    ]
    token = "{" + hashlib.sha256("\0".join(hashed).encode()).hexdigest() + "}"
    texts[f"{_PREFIX}config.h"] = config(block, token)
    files = {f"sources/{name}": texts[name] for name in headers}
    files[f"sources/{SOURCE}"] = _merge(block, texts, interface, set(headers))
    files["modelDescription.xml"] = describe(token)
    files["documentation/licenses/license.txt"] = _LICENSE
    if version == "3.0":
        files["sources/buildDescription.xml"] = build_description(block, [SOURCE])
    return files, token


def _merge(block: Block, texts: Mapping[str, str], interface: str, standard: set[str]) -> str:
    """One C file: the interface with its headers put in, then the model, which must not see macros
    of the former.

    ``texts``: sources by name; ``interface``: file of the FMI functions; ``standard``: headers
    that stay separate.
    """
    seen: set[str] = set()

    def put_in(name: str) -> str:
        """The text of a file with its own includes put in, each once; standard headers stay, those
        of other blocks become comments.
        """
        if name in seen:
            return ""
        seen.add(name)
        lines = []
        for line in texts[name].splitlines(keepends=True):
            found = _INCLUDE.match(line)
            if found is None or found[1] in standard:
                lines.append(line)
            elif found[1] in texts:
                lines.append(put_in(found[1]))
            else:  # of another block
                lines.append(f"/* {found[1]} */\n")
        return "".join(lines)

    first = put_in(f"{_PREFIX}warnings.h") + put_in(interface)
    kept = set(_MACRO.findall(texts.get(block.header, "")))
    macros = [
        name
        for name in dict.fromkeys(_MACRO.findall(first))
        if name not in kept and not name.endswith("_H")
    ]
    undefined = "".join(f"#undef {name}\n" for name in macros)
    model = "".join(put_in(name) for name in sorted(block.sources) if name.endswith(".c"))
    return f"{first}\n/* The model. */\n{undefined}\n{model}"


def _interface(version: str) -> str:
    return f"{_PREFIX}fmi{version[0]}.c"


def _check_name(block: Block, fixed: Mapping[str, str]) -> None:
    """Refuse a model whose files or names in C are those of the fixed files: BuildError."""
    taken = {file.lower(): file for file in fixed}
    files = [
        file for file in block.sources if file.lower() in taken or file.lower().startswith(_PREFIX)
    ]
    words = {word for text in fixed.values() for word in _WORD.findall(text)}
    stem = Path(block.header).stem
    header = _WORD.findall(block.sources.get(block.header, ""))
    own = {word for word in header if stem and word.lower().startswith(f"{stem}_".lower())}
    if found := sorted([*files, *(own & words)]):
        raise BuildError(
            f"name of the model, with its variant: given {stem!r}, which gives {found[0]}, a "
            "name of the fixed files of an FMU; expected another name"
        )


def _zip(files: Mapping[str, bytes]) -> bytes:
    """A zip file without times: the same files give the same bytes. modelDescription.xml comes
    first.
    """
    out = BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name in sorted(files, key=lambda name: (name != "modelDescription.xml", name)):
            info = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            info.create_system = 3
            info.compress_type = zipfile.ZIP_DEFLATED
            info.external_attr = (0o755 if name.startswith("binaries/") else 0o644) << 16
            archive.writestr(info, files[name], compresslevel=9)
    return out.getvalue()
