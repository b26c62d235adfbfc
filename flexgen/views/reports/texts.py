"""Results as text with tables: what ``to_text`` returns and the command line prints.

A number that is not finite is a dash, as None in JSON.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from flexgen.base.display import number, plain
from flexgen.base.registry import provides
from flexgen.views.reports.row_views import row_cells, scales_of
from flexgen.views.reports.text_tables import figures, one_line, paragraph, table

if TYPE_CHECKING:
    from flexgen.analysis.analyze import Analysis
    from flexgen.codegen.build.generate import GeneratedLibrary
    from flexgen.inversion.solution import Solution
    from flexgen.model.elements import RobotModel
    from flexgen.paths.inverse_kinematics.search import Configuration
    from flexgen.simulation.result import Simulation
    from flexgen.studies.check.finding import Check, Finding

SHOWN = 5  # reasons of failures of a sweep that are named, and cases that are named for each

# keys of the figures in the short text of a solution, of which it has six rows, seven with angles
SUMMARY = frozenset(
    {
        "status",
        "cpu_s",
        "preactuation_s",
        "torque_max_Nm",
        "speed_max_rad_s",
        "tool_error_max_m",
        "tool_error_max_rad",
    }
)

Row = tuple[str, Any, str]  # quantity, value, unit


def description_text(data: dict[str, Any]) -> str:
    """The description of a model as text, from the data of `flexgen.describe`."""
    name = data["name"]
    parts = [
        paragraph(
            name
            + (f"@{data['variant']}" if data["variant"] else "")
            + f": {one_line(data['description'])}"
        ),
        figures(
            [
                ("file", data["file"], ""),
                ("motors n_m", data["n_m"], ""),
                ("actuated arm coordinates n_g", data["n_g"], ""),
                ("non-actuated arm coordinates n_e", data["n_e"], ""),
                ("degrees of freedom", data["dof"], ""),
                ("mass of the arm", sum(body["mass"] for body in data["bodies"]), "kg"),
                ("motor coupling", data["motor_coupling"], ""),
                ("output", _output(data["output"]), ""),
            ]
        ),
        table(
            [
                [c["name"], c["unit"], c["element"], c["type"], _drive(c), *_stiffness(c)]
                for c in data["coordinates"]
            ],
            ("coordinate", "unit", "element", "type", "drive or spring", "stiffness", "damping"),
        ),
        table(
            [
                [
                    m["name"],
                    ", ".join(m["drives"]),
                    ", ".join(
                        _ratio(*row) for row in zip(m["ratio"], m["ratio_unit"], strict=True)
                    ),
                    m["inertia"],
                    m["torque_max"],
                    m["speed_max"],
                ]
                for m in data["motors"]
            ],
            ("motor", "drives", "ratio", "inertia kg m^2", "torque max N m", "speed max rad/s"),
        ),
    ]
    if data["sensors"]:
        rows = [
            [s["name"], s["type"], s["place"], ", ".join(s["channels"]), s["unit"], s["noise"]]
            for s in data["sensors"]
        ]
        parts.append(table(rows, ("sensor", "type", "place", "channels", "unit", "noise")))
    if data["moves"]:
        rows = [[m["name"], m["type"], m["duration"], m["smoothness"]] for m in data["moves"]]
        parts.append(table(rows, ("move", "type", "duration s", "smoothness")))
    if data["variants"]:
        parts.append(
            paragraph(
                "variants: " + ", ".join(f"{name}@{variant}" for variant in data["variants"])
            )
        )
    if data["source"]:
        parts.append(paragraph(f"source: {one_line(data['source'])}"))
    return "\n\n".join(parts)


def _ratio(ratio: float, unit: str) -> str:
    """A gear ratio; of a translation with its unit."""
    return number(float(ratio)) + ("" if unit == "rad/rad" else f" {unit}")


def _output(output: dict[str, Any]) -> str:
    axes = f" {output['axes']}" if output["axes"] else ""
    return f"{output['type']}{axes} ({output['size']} scalars)"


def _drive(coordinate: dict[str, Any]) -> str:
    """The gear of a coordinate, or its spring if no motor drives it."""
    gear = coordinate.get("gear")
    spring = coordinate.get("spring")
    if gear is not None:
        elastic = gear["type"] != "rigid"
        loop = gear.get("hysteresis")
        lost = (
            sum(each["lost_motion"] for each in (loop if isinstance(loop, list) else [loop]))
            if loop
            else 0.0
        )
        lossy = f", lost motion {lost:.3g} {coordinate['unit']}" if loop else ""
        return (
            f"elastic gear, {gear['spring']['type']}, {gear['side']} side{lossy}"
            if elastic
            else "rigid gear"
        )
    return f"beam {coordinate['mode']}" if spring is None else f"spring, {spring['type']}"


def _stiffness(coordinate: dict[str, Any]) -> tuple[str | None, str | None]:
    """Stiffness (of a nonlinear spring the low one) and damping, on the side given in the model
    file.
    """
    holder = coordinate.get("gear") or coordinate
    spring = holder.get("spring")
    if spring is None:
        return None, None
    stiffness = float(spring.get("stiffness", spring.get("low")))
    damping = float(holder.get("damping") or 0.0)
    force, unit = (
        ("N m", "rad")
        if coordinate["unit"] == "rad" or holder.get("side") == "motor"
        else ("N", "m")
    )
    return f"{number(stiffness)} {force}/{unit}", f"{number(damping)} {force} s/{unit}"


def figure_rows(result: Solution | Simulation) -> list[Row]:
    """Label, value and unit of the figures of a result; lengths have one unit, angles too."""
    found = [replace(figure, value=plain(figure.value)) for figure in result.figures()]
    return row_cells(found, scales_of(found))


def summary_of_solution(solution: Solution) -> str:
    """Six rows of a solution: status, errors, torque, speed, pre-actuation and computing time."""
    wanted = {figure.label for figure in solution.figures() if figure.key in SUMMARY}
    rows = [row for row in figure_rows(solution) if row[0] in wanted]
    title = f"{solution.model.title}, move {solution.move.name}"
    return "\n\n".join([f"{title}\n\n{figures(rows)}", *_further(solution)])


def _further(solution: Solution) -> list[str]:
    """Notes on the path and the methods that were tried before, each as one text, where any."""
    unknown = solution.model.not_measured_sentence
    said = [*solution.details.get("notes", ()), *([unknown] if unknown else [])]
    notes = [paragraph(f"note: {line}") for line in said]
    lines = [f"tried before: {line}" for line in solution.details.get("attempts", ())]
    return ["\n".join(each) for each in (notes, lines) if each]


def solution_details(solution: Solution) -> str:
    """Further figures of the method and of the simulation of a solution, and what its status
    means.
    """
    rows: list[Row] = [
        (key.replace("_", " "), value if isinstance(value, int | float) else str(value), "")
        for key, value in plain(dict(solution.details)).items()
        if value not in (None, [], {}, "") and key not in ("notes", "attempts")
    ]
    if solution.simulation is not None:
        run = solution.simulation
        rows += [
            ("integrator of the simulation", run.integrator, ""),
            ("evaluations of the equations of motion", run.evaluations, ""),
            ("wall time of the simulation", run.wall_s, "s"),
        ]
    meaning = paragraph(f"{solution.status}: {solution.status.sentence} {solution.status.advice}")
    return f"{figures(rows)}\n\n{meaning}" if rows else meaning


def steps_text(
    analysis: Analysis,
    library: GeneratedLibrary,
    checked: Mapping[str, float],
    solution: Solution,
    seconds: float,
) -> str:
    """The main figures of all steps: analysis, library, its comparison with the equations,
    solution; wall time [s].
    """
    robot = analysis.model
    facts = plain(analysis.to_dict())
    slowest = facts["unstable_time_constant_s"]
    rows: list[Row] = [
        ("model", robot.title, ""),
        ("motors, degrees of freedom", f"{robot.n_m}, {robot.dof}", ""),
        ("lowest mode", facts["modes_hz"][0] if facts["modes_hz"] else None, "Hz"),
        ("phase of the output", facts["phase"], ""),
        ("slowest unstable zero", 1 / slowest if slowest else None, "1/s"),
        ("structural index", facts["structural_index"], ""),
        ("C functions generated", len(library.functions), ""),
        ("C library built in", None if library.cached else library.seconds, "s"),
        ("C inverse_dynamics, one call from Python", checked["call_us"], "us"),
        ("difference of C and equations, largest", checked["difference_Nm"], "N m"),
        ("move", solution.move.name, ""),
        *figure_rows(solution),
        ("total time, wall", seconds, "s"),
    ]
    return figures(rows)


@provides("Check.to_text")
def text_of_check(check: Check) -> str:
    """One line, and the numbers that are unusual or wrong, with what to look at, once each."""
    found = (*check.errors, *check.warnings)
    each = [
        "\n".join(
            [
                paragraph(f"{f.mark}: {f.key}"),
                paragraph(f"  {f.quantity}: {f.value}, usual {f.usual}"),
                *([paragraph(f"  look at: {f.advice}")] if f.advice else []),
            ]
        )
        for f in found
    ]
    return "\n\n".join([check.summary(), *each])


@provides("Check.all_findings")
def findings_of_check(check: Check) -> str:
    """A table of all numbers that were checked."""
    return _findings_table(check.findings)


def _findings_table(findings: Sequence[Finding]) -> str:
    rows = [[f.mark, f.key, f.quantity, f.value, f.usual] for f in findings]
    return table(rows, ("mark", "key", "quantity", "value", "usual"))


def models_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """The list of `flexgen.models` as a table."""
    head = ("name", "motors", "actuated", "elastic", "dof", "description")
    text = table(
        [
            [r["name"], r["n_m"], r["n_g"], r["n_e"], r["dof"], one_line(r["description"])]
            for r in rows
        ],
        head,
    )
    variants = [f"{row['name']}@{name}" for row in rows for name in row["variants"]]
    return text + ("\n\n" + paragraph("variants: " + ", ".join(variants)) if variants else "")


def library_text(robot: RobotModel, library: GeneratedLibrary) -> str:
    """The functions of a library, and the files that were written: those a user needs by name."""
    from flexgen.codegen.emission.c_functions import inversion_reason

    done = f"built in {library.seconds:.1f} s" if not library.cached else "written, not compiled"
    lines = [
        (
            f"{robot.title}: {done if library.written else 'nothing has changed'} in "
            f"{library.directory}"
        )
    ]
    lines += ["", paragraph("functions: " + ", ".join(library.functions))]
    reason = inversion_reason(robot, library.functions)
    if reason is not None:
        lines += ["", paragraph(f"not in this library: invert and stream, because {reason}")]
    if library.written:
        sources = [
            path for path in library.files if path.suffix == ".c" or path.parent.name == "src"
        ]
        lines += ["", *(f"wrote {path}" for path in library.files if path not in sources)]
        lines += [f"wrote {sources[0].parent} ({len(sources)} sources)"] if sources else []
    return "\n".join(lines)


def configurations_text(robot: RobotModel, found: Sequence[Configuration]) -> str:
    """The configurations of `flexgen.kinematics` as a table."""
    rows = []
    for c in found:
        flags = " ".join(f"{sign:+d}" for sign in c.flags)
        near = f"{c.distance:.3g} {c.nearest_singularity}{', singular' if c.singular else ''}"
        rows.append([*map(float, c.q), "yes" if c.within_limits else "no", flags, near])
    joints = (f"{c.name}, {c.unit}" for c in (robot.coordinates[i] for i in robot.i_g))
    return table(rows, (*joints, "in limits", "shoulder elbow wrist", "singularity distance"))


def failure_lines(groups: Sequence[Mapping[str, Any]], where: str) -> list[str]:
    """A line for each of the first reasons of failed cases of a sweep; ``where``: where the other
    reasons are.
    """
    out = []
    for cases, reason in ((group["cases"], group["reason"]) for group in groups[:SHOWN]):
        names = ", ".join(map(str, cases[:SHOWN])) + (", ..." if len(cases) > SHOWN else "")
        many = f"{len(cases)} cases failed ({names}), for example case {cases[0]}"
        out.append(f"{many if len(cases) > 1 else f'case {cases[0]} failed'}: {reason}")
    more = sum(len(group["cases"]) for group in groups[SHOWN:])
    return [*out, *([f"{more} more cases failed for other reasons; see {where}"] if more else [])]
