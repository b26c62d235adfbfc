"""The page of all keys of files, rendered from their rows."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from flexgen.base.spec.keys import REQUIRED, Form, Key, Kinds, Schema
from flexgen.base.spec.memory import HYSTERESIS, LUGRE
from flexgen.base.spec.schema import key_schemas
from flexgen.base.spec.tables import LARGEST
from flexgen.feedback.loop.controller_files import CONTROLLER
from flexgen.identification.records import keys as records
from flexgen.model.format.format import (
    BEAM,
    BEAM_TIP,
    BENDING,
    ELEMENT,
    JOINT,
    LINK,
    LOOP,
    LOOP_FRAME,
    MODEL,
    STRETCH,
    TOOL,
    TORSION,
    UNCERTAINTY,
    URDF,
    VARIANT,
)
from flexgen.model.format.format_devices import MOTOR, SENSOR
from flexgen.model.format.format_lines import ANCHOR, LINE
from flexgen.model.format.format_programs import PROGRAM, STEP
from flexgen.model.format.format_robot import (
    BODY,
    COGGING,
    COUNTERBALANCE,
    DOF,
    ENCODER_ERROR,
    ERROR,
    GEAR,
    JOINT_SPRING,
    PLACEMENT,
    RIPPLE,
    SPRING,
    friction,
)
from flexgen.model.format.format_tasks import CARRIED, FRAME, LEG, MOVE, OUTPUT
from flexgen.model.position_servo.keys import LOW_PASS, NOTCH, SERVO_TABLE
from flexgen.studies.scenarios import scenario_file as scenario
from flexgen.studies.sweeps.grid_file import GRID, RANDOM

HUGE = 1e9  # bounds that no user reaches
PAGE = Path(__file__).resolve().parents[2] / "docs" / "model_keys.md"
RECORDINGS = PAGE.with_name("recording_keys.md")
TABLES: dict[str, Form] = {
    "The file": MODEL,
    "`[[element]]`": ELEMENT,
    "`[[element.dof]]`": DOF,
    "`gear`": GEAR,
    "`spring` of a gear": SPRING,
    "`hysteresis`": HYSTERESIS,
    "`transmission_error`": ERROR,
    "`cogging`": COGGING,
    "`torque_ripple`": RIPPLE,
    "`encoder_error`": ENCODER_ERROR,
    "`lugre`": LUGRE,
    "`spring` of a degree of freedom": JOINT_SPRING,
    "`friction`": friction(),
    "`counterbalance`": COUNTERBALANCE,
    "`[element.beam]`": BEAM,
    "`[[element.beam.bending]]`": BENDING,
    "`torsion` of a beam": TORSION,
    "`stretch` of a beam": STRETCH,
    "`tip` of a beam": BEAM_TIP,
    "`body`, `[payload]`": BODY,
    "`[base]`, `origin`, `link`": PLACEMENT,
    "`[tool]`": TOOL,
    "`[[motor]]`": MOTOR,
    "`[[loop]]`": LOOP,
    "`from`, `to` of a loop": LOOP_FRAME,
    "`[[line]]`": LINE,
    "`from`, `to` of a line": ANCHOR,
    "`[[sensor]]`": SENSOR,
    "`[uncertainty]`": UNCERTAINTY,
    "`[servo]`": SERVO_TABLE,
    "`[output]`": OUTPUT,
    "`[[frame]]`": FRAME,
    "`[[move]]`": MOVE,
    "`carried` of a move": CARRIED,
    "`legs` of a move": LEG,
    "`[[program]]`": PROGRAM,
    "`[[program.step]]`": STEP,
    "`[variant.NAME]`": VARIANT,
    "`[urdf]`": URDF,
    '`[joint.NAME]`, `[joint."*"]`': JOINT,
    "`[link.NAME]`": LINK,
}
OTHERS: dict[str, Form] = {
    "Controller files": CONTROLLER,
    "`[[low_pass]]` of a controller or servo": LOW_PASS,
    "`[[notch]]` of a controller or servo": NOTCH,
    "Grid files": GRID,
    "`[random]` of a grid": RANDOM,
    "Scenario files": scenario.FORMATS[2],
    "`[model]` of a scenario": scenario.MODEL,
    "`[[output]]` of a scenario": scenario.OUTPUT,
    "`[draw]` of a scenario": scenario.SPANS,
    "`[[segment]]` of a scenario": scenario.SEGMENT,
    "`[[disturbance]]` of a scenario": scenario.DISTURBANCE,
    "`[measures]` of a scenario": scenario.MEASURES,
    "`windows` of measures": scenario.WINDOW,
    "`[score]` of a scenario": scenario.SCORE,
    "`[[set]]` of a scenario": scenario.SET,
    "`factors` of a set": scenario.FACTOR,
    "`[accept]` of a scenario": scenario.LIMITS,
}
TOP = """# Keys of model files

This page lists all keys of [model files](../models/README.md). It is written from the rows in
`flexgen/model/format*.py`, from which the reader, the JSON schema (`flexgen schema`) and the \
writer are made too. A
required key that ends in `_rad` or `_deg` is given under one of the two. A name is a letter, \
then at most 30 letters,
digits or underscores. Numbers have a magnitude of 1e-18 to 1e12, or are 0.

The sections at the end are about files of [controllers](control.md#controllers), of the \
[grids](cluster.md) of sweeps
and of the scenarios of benchmarks; their numbers have any magnitude. A controller file with the \
`type` of a feedback
law has the parameters of its class as keys. A scenario of format 1 has `[[disturbance]]` instead \
of `rule`, `[draw]`
and `[[segment]]`, and no `version` of `[measures]`.
"""


RECORDINGS_TOP = """# Keys of descriptions of recordings

This page lists all keys of the `.toml` files that describe [records of a real robot](records.md).
It is written from the rows in `flexgen/identification/records/keys.py`, which the reader takes \
too.
"""


def recordings_page() -> str:
    """The text of the page of descriptions."""
    lines = [RECORDINGS_TOP]
    for table in records.TABLES:
        lines += [f"## {table.title}", "", f"{table.meaning}.", ""]
        lines += ["| key | value | default | meaning |", "|---|---|---|---|"]
        lines += [f"| `{r.key}` | {r.value} | {r.default} | {r.meaning} |" for r in table.rows]
        lines.append("")
    return "\n".join(lines)


def page() -> str:
    """The text of the page."""
    return "\n".join(
        [
            TOP,
            *(line for title, form in (TABLES | OTHERS).items() for line in section(title, form)),
        ]
    )


def section(title: str, form: Form) -> Iterator[str]:
    """The keys of a table; those of several kinds together, with the kinds that have them."""
    yield from (f"## {title}", "", f"{form.doc[0].upper()}{form.doc[1:]}.", "")
    if not isinstance(form, Kinds):
        yield from (
            "| key | value | default | meaning |",
            "|---|---|---|---|",
            *rows(form.keys),
            "",
        )
        return
    kinds = (
        (kind, " (default)" * (kind == form.default), own.doc) for kind, own in form.kinds.items()
    )
    yield from (f'- `type = "{kind}"`{default}: {doc}' for kind, default, doc in kinds)
    found: dict[str, list[str]] = {}
    for kind, own in form.kinds.items():
        for row in rows((*form.shared, *own.keys)):
            found.setdefault(row, []).append(kind)
    yield from ("", "| types | key | value | default | meaning |", "|---|---|---|---|---|")
    yield from (
        f"| {'all' if len(of) == len(form.kinds) else ', '.join(of)} {row}"
        for row, of in found.items()
    )
    yield ""


def rows(keys: Sequence[Key]) -> list[str]:
    """A row of a table for each key."""
    out = []
    for key in keys:
        schemas = key_schemas(key)
        first = next(iter(schemas.values()))
        default = "required" if key.default is REQUIRED else str(first.get("default", "")).lower()
        names = ", ".join(f"`{name}`" for name in schemas)
        doc = first.get("description", "").removesuffix(key.type.rule)
        out.append(f"| {names} | {value_text(first)} | {default} | {doc} |")
    return out


def value_text(schema: Schema) -> str:
    """Short description of a value."""
    if "$ref" in schema or "allOf" in schema:
        return f"table `{(schema.get('allOf') or [schema])[0]['$ref'].rpartition('/')[2]}`"
    if "title" in schema:
        return str(schema["title"])
    if "enum" in schema:
        return ", ".join(f"`{word}`" for word in schema["enum"])
    kind = schema.get("type", "")
    if kind == "number":
        return _number_text(schema)
    if kind == "integer":
        return f"whole number from {schema['minimum']} to {schema['maximum']}"
    if kind == "array":
        return _list_text(schema)
    if kind == "object" or "oneOf" in schema:
        return "table"
    if kind == "boolean":
        return "`true`, `false`"
    if kind == "string":
        return "name" if "pattern" in schema else "text"
    return " or ".join(dict.fromkeys(value_text(one) for one in schema["anyOf"]))


def _number_text(schema: Schema) -> str:
    """A number with its bounds, but for those that all numbers have."""
    least = schema.get("minimum", -LARGEST)
    most = schema.get("maximum", LARGEST)
    most = LARGEST if most >= HUGE else most
    bounds = [f"> {schema['exclusiveMinimum']:g}"] if "exclusiveMinimum" in schema else []
    if least > -LARGEST and most < LARGEST:
        return f"number from {least:g} to {most:.10g}"
    bounds += [f">= {least:g}"] * (least > -LARGEST) + [f"<= {most:.10g}"] * (most < LARGEST)
    return f"number {', '.join(bounds)}".rstrip()


def _list_text(schema: Schema) -> str:
    item = value_text(schema["items"]).removeprefix("table ")
    of = (
        item
        if item.startswith("list")
        else re.sub(r"\bnumber\b", "numbers", item, count=1)
        .replace("text", "texts")
        .replace("table", "tables")
    )
    sizes = [
        (one.get("minItems", 0), one.get("maxItems", 0)) for one in schema.get("anyOf", [schema])
    ]
    if not sizes[0][1]:
        return f"list of {of}"
    return (
        " or ".join(str(low) if low == high else f"{low} to {high}" for low, high in sizes)
        + f" {of}"
    )
