"""modelDescription.xml of FMI 2.0 and 3.0, and the list of sources. Every text is escaped."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from xml.sax.saxutils import quoteattr

from flexgen.base.version import __version__
from flexgen.exports.fmu.block import Block
from flexgen.exports.fmu.variables import OUTPUT, RATE, STATE, STATUS, TIME, UNITS, Variable

_NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_BASE = ("kg", "m", "s", "rad")


def element(name: str, attributes: Mapping[str, object], inner: Sequence[str] = ()) -> list[str]:
    """Lines of an XML element; attributes with the value None are left out."""
    words = [
        f"{key}={quoteattr(_NOT_XML.sub('?', str(value)))}"
        for key, value in attributes.items()
        if value is not None
    ]
    head = " ".join([f"<{name}", *words])
    return (
        [f"{head}/>"]
        if not inner
        else [f"{head}>", *(f"  {line}" for line in inner), f"</{name}>"]
    )


def number(x: float | int | None) -> str | None:
    """A number with all its digits."""
    return None if x is None else str(x) if isinstance(x, int) else repr(float(x))


def _units(block: Block) -> list[str]:
    """XML of the units in use, each with its powers of SI units."""
    used = sorted({v.unit for v in block.variables if v.unit})
    inner = []
    for unit in used:
        powers = {key: UNITS[unit][key] for key in _BASE if key in UNITS[unit]}
        inner += element("Unit", {"name": unit}, element("BaseUnit", powers))
    return element("UnitDefinitions", {}, inner)


def _log() -> list[str]:
    """XML of the categories of log messages."""
    return element(
        "LogCategories",
        {},
        [
            *element("Category", {"name": "logStatusError", "description": "why a call failed"}),
            *element(
                "Category", {"name": "logStatusWarning", "description": "what a call warns of"}
            ),
        ],
    )


def _experiment(block: Block) -> list[str]:
    return element(
        "DefaultExperiment", {"startTime": "0", "stopTime": "1", "stepSize": number(block.step)}
    )


# --- FMI 2.0 -------------------------------------------------------------------------------------


def description_2(block: Block, token: str, sources: Sequence[str]) -> str:
    """modelDescription.xml of FMI 2.0."""
    files = element(
        "SourceFiles", {}, [line for file in sources for line in element("File", {"name": file})]
    )
    common = {
        "modelIdentifier": block.name,
        "canNotUseMemoryManagementFunctions": "false",
        "canGetAndSetFMUstate": "true",
        "canSerializeFMUstate": "true",
        "providesDirectionalDerivative": str(block.derivatives).lower(),
    }
    stepping = {"canHandleVariableCommunicationStepSize": "true", "canInterpolateInputs": "false",
                "maxOutputDerivativeOrder": "0", "canRunAsynchronuously": "false"}  # fmt: skip
    position = {v.reference + (v.whole << 20): k + 1 for k, v in enumerate(block.variables)}
    scalars = [line for v in block.variables for line in _scalar_2(v, position)]
    inner = [
        *element("ModelExchange", common, files),
        *element("CoSimulation", common | stepping, files),
        *_units(block),
        *_log(),
        *_experiment(block),
        *element("ModelVariables", {}, scalars),
        *_structure_2(block, position),
    ]
    root = {
        "fmiVersion": "2.0",
        "modelName": block.title,
        "guid": token,
        "description": block.text or None,
        "generationTool": f"flexgen {__version__}",
        "variableNamingConvention": "structured",
        "numberOfEventIndicators": "0",
    }
    return "\n".join(
        [
            '<?xml version="1.0" encoding="UTF-8"?>',
            *element("fmiModelDescription", root, inner),
            "",
        ]
    )


def _scalar_2(v: Variable, position: Mapping[int, int]) -> list[str]:
    """The element of a variable in a model description of FMI 2, as lines; ``position``: its
    number by value reference.
    """
    of = position[1000 * STATE + v.index] if v.kind == RATE else None
    value: dict[str, object] = {"start": number(v.start)}
    if not v.whole:
        value = {"unit": v.unit, "nominal": number(v.nominal), "derivative": of, **value}
    outer = {
        "name": v.name,
        "valueReference": v.reference,
        "description": v.text,
        "causality": v.causality,
        "variability": v.variability,
        "initial": v.initial,
    }
    return element("ScalarVariable", outer, element("Integer" if v.whole else "Real", value))


def _structure_2(block: Block, position: Mapping[int, int]) -> list[str]:
    """The element ModelStructure of FMI 2, as lines: outputs, derivatives and initial unknowns
    with the variables on which they depend, by number.
    """

    def unknown(v: Variable) -> list[str]:
        """XML of an output or derivative in FMI 2: its position, and those of the variables that
        it depends on.
        """
        depends = (
            None if v.depends is None else " ".join(str(position[r]) for r in sorted(v.depends))
        )
        return element(
            "Unknown", {"index": position[v.reference + (v.whole << 20)], "dependencies": depends}
        )

    inner = element("Outputs", {}, [line for v in block.of(OUTPUT, STATUS) for line in unknown(v)])
    if block.of(RATE):
        inner += element("Derivatives", {}, [line for v in block.of(RATE) for line in unknown(v)])
    first = [v for v in block.of(OUTPUT, RATE, STATUS) if v.initial == "calculated"]
    if first:
        inner += element("InitialUnknowns", {}, [line for v in first for line in unknown(v)])
    return element("ModelStructure", {}, inner)


# --- FMI 3.0 -------------------------------------------------------------------------------------


def description_3(block: Block, token: str) -> str:
    """modelDescription.xml of FMI 3.0."""
    common = {
        "modelIdentifier": block.name,
        "canGetAndSetFMUState": "true",
        "canSerializeFMUState": "true",
        "providesDirectionalDerivatives": str(block.derivatives).lower(),
    }
    stepping = {"canHandleVariableCommunicationStepSize": "true", "maxOutputDerivativeOrder": "0"}
    inner = [
        *element("ModelExchange", common),
        *element("CoSimulation", common | stepping),
        *_units(block),
        *_log(),
        *_experiment(block),
        *element("ModelVariables", {}, [line for v in block.variables for line in variable_3(v)]),
        *_structure_3(block),
    ]
    root = {
        "fmiVersion": "3.0",
        "modelName": block.title,
        "instantiationToken": token,
        "description": block.text or None,
        "generationTool": f"flexgen {__version__}",
        "variableNamingConvention": "structured",
    }
    return "\n".join(
        [
            '<?xml version="1.0" encoding="UTF-8"?>',
            *element("fmiModelDescription", root, inner),
            "",
        ]
    )


def variable_3(v: Variable) -> list[str]:
    """The element of a variable in a model description of FMI 3, as lines."""
    attributes: dict[str, object] = {
        "name": v.name,
        "valueReference": v.reference,
        "description": v.text,
        "causality": v.causality,
        "variability": v.variability,
        "initial": v.initial,
    }
    if v.kind == TIME:
        attributes.pop("initial")
    attributes["start"] = number(v.start)
    if not v.whole:
        state = 1000 * STATE + v.index if v.kind == RATE else None
        attributes |= {"unit": v.unit, "nominal": number(v.nominal), "derivative": state}
    return element("Int32" if v.whole else "Float64", attributes)


def _structure_3(block: Block) -> list[str]:
    """The element ModelStructure of FMI 3, as lines: as `_structure_2`, by value reference."""

    def unknown(name: str, v: Variable) -> list[str]:
        depends = None if v.depends is None else " ".join(map(str, sorted(v.depends)))
        return element(name, {"valueReference": v.reference, "dependencies": depends})

    inner = [line for v in block.of(OUTPUT, STATUS) for line in unknown("Output", v)]
    inner += [line for v in block.of(RATE) for line in unknown("ContinuousStateDerivative", v)]
    first = [v for v in block.of(OUTPUT, RATE, STATUS) if v.initial == "calculated"]
    inner += [line for v in first for line in unknown("InitialUnknown", v)]
    return element("ModelStructure", {}, inner)


def build_description(block: Block, sources: Sequence[str]) -> str:
    """sources/buildDescription.xml of FMI 3.0."""
    files = [line for file in sources for line in element("SourceFile", {"name": file})]
    file_set = element("SourceFileSet", {"language": "C99"}, files)
    library = element("Library", {"name": "m"})
    configuration = element(
        "BuildConfiguration", {"modelIdentifier": block.name}, [*file_set, *library]
    )
    root = element("fmiBuildDescription", {"fmiVersion": "3.0"}, configuration)
    return "\n".join(['<?xml version="1.0" encoding="UTF-8"?>', *root, ""])
