"""The C library of a model as texts, for an export that brings its own copy of it."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flexgen.base.errors import ArgumentError
from flexgen.base.files.atomic_files import temporary_folder
from flexgen.codegen.build.generate import generate
from flexgen.codegen.build.source_folder import folder_of, write_folder
from flexgen.codegen.emission.c_functions import inversion_reason
from flexgen.codegen.emission.digest import model_digest
from flexgen.codegen.emission.spec import PrecisionName, library_name
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.exports.exported import Exported
from flexgen.model.elements import RobotModel

ModelLike = str | Path | RobotModel | Equations
_KEPT = 4  # libraries that are kept, so that several exports of a model emit it once
_LAST: dict[tuple[str, ...], Emitted] = {}


@dataclass(frozen=True)
class StreamOptions:
    """Options of a stream: period [s] of its updates, intervals of the horizon, samples in each,
    tolerance.
    """

    period: float
    intervals: int
    samples_per_interval: int
    tolerance: float


@dataclass(frozen=True)
class Emitted:
    """The library of a model: one header and one source.

    Parameters
    ----------
    equations : Equations
        The definition of the model.
    name : str
        First part of every symbol; an identifier of C, see
        `flexgen.codegen.emission.spec.library_name`.
    manifest : dict
        Ports, sizes and names, see `flexgen.codegen.build.generate`.
    header, source : str
        Text of ``<name>.h`` and ``<name>.c``.
    """

    equations: Equations
    name: str
    manifest: dict[str, Any]
    header: str
    source: str

    @property
    def model(self) -> RobotModel:
        """The model."""
        return self.equations.model

    @property
    def sizes(self) -> dict[str, int]:
        """``n_a``, ``n_m`` and so on."""
        return dict(self.manifest["sizes"])

    @property
    def functions(self) -> list[dict[str, Any]]:
        """The functions of one point, with their ports."""
        return list(self.manifest["functions"])

    @property
    def streams(self) -> bool:
        """Whether the library has invert and streams."""
        return any(row["name"] == "stream_update" for row in self.manifest["c_functions"])

    @property
    def stream(self) -> StreamOptions | None:
        """Recommended options of a stream; None where the home pose has none."""
        found = [
            _option(self.header, self.name, word)
            for word in ("PERIOD", "INTERVALS", "SAMPLES_PER_INTERVAL")
        ]
        tolerance = _option(self.header, self.name, "TOLERANCE")
        if None in found or tolerance is None:
            return None
        return StreamOptions(
            float(found[0] or 0), int(found[1] or 0), int(found[2] or 0), float(tolerance)
        )

    def texts(self) -> dict[str, str]:
        """Header and source by file name."""
        return {f"{self.name}.h": self.header, f"{self.name}.c": self.source}

    def write(
        self,
        kind: str,
        directory: Any,
        texts: Mapping[str, str],
        *,
        force: bool,
        default: str = "",
        **more: Any,
    ) -> Exported:
        """Write the ``texts`` of an export by name to a folder; ``default``: its name below
        ``exports``, where none is given; ``force``: also over files that were changed; ``more``:
        fields of the result.
        """
        folder = folder_of(directory, default or f"{self.name}_{kind}")
        files = write_folder(folder, kind, self.name, texts, force=force)
        return Exported(kind, self.model.name, folder, files, self.model.variant, **more)


def _option(header: str, name: str, word: str) -> str | None:
    """The value of a macro of the recommended options of a stream."""
    found = re.search(rf"^#define {name.upper()}_STREAM_{word} (\S+) /\*", header, re.MULTILINE)
    return found[1].rstrip("f") if found else None


def resolve(model: ModelLike) -> Equations:
    """Equations without run-time parameters; ArgumentError for something else."""
    equations = model if isinstance(model, Equations) else derive(model)
    if not isinstance(model, Equations):
        return equations
    if model.parameters:
        names = ", ".join(parameter.name for parameter in model.parameters)
        raise ArgumentError(
            f"model: given equations with run-time parameters ({names}), expected numbers; "
            "exports have constants: give the model, with overrides= where a value differs"
        )
    return model


def emit(
    model: ModelLike,
    *,
    precision: PrecisionName = "double",
    streams: bool = False,
    parts: tuple[str, ...] = (),
) -> Emitted:
    """The library of a model, in two files.

    Parameters
    ----------
    model : str, Path, RobotModel or Equations
    precision : str
        ``"double"`` or ``"single"``.
    streams : bool
        True: the model must have inverse dynamics along paths and streams.
    parts : tuple of str
        As of `flexgen.generate`.

    Raises
    ------
    ModelError
        The model cannot be read.
    BuildError, ArgumentError
        A name or an argument cannot be used, or the model has no streams.
    """
    equations = resolve(model)
    if streams:
        refuse_without_streams(equations.model)
    key = (model_digest(equations.model), precision, *parts)
    found = _LAST.get(key)
    if found is None:
        found = _generate(equations, precision, parts)
        while len(_LAST) >= _KEPT:
            _LAST.pop(next(iter(_LAST)))
        _LAST[key] = found
    return found


def _generate(equations: Equations, precision: PrecisionName, parts: tuple[str, ...]) -> Emitted:
    """The library, derived and written."""
    with temporary_folder() as folder:
        made = generate(
            equations,
            folder,
            build=False,
            precision=precision,
            parts=parts,
            amalgamate=True,
            progress=False,
        )
        name = library_name(equations.model)
        manifest = json.loads((made.directory / "manifest.json").read_text(encoding="utf-8"))
        header, source = (
            (made.directory / f"{name}.{end}").read_text(encoding="ascii") for end in "hc"
        )
    return Emitted(equations, name, manifest, header, source)


def refuse_without_streams(model: RobotModel) -> None:
    """ArgumentError where the library of a model has no streams."""
    from flexgen.dynamics.mechanics.signatures import offered_functions

    reason = inversion_reason(model, offered_functions(model))
    if reason is not None:
        raise ArgumentError(
            f"model {model.name}: given a robot without streams, because {reason}; expected one "
            "with as many outputs as motors and simplified motor coupling; change the output "
            "or the motors of the model file, or export only what needs no stream"
        )
