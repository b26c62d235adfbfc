"""The gallery: each script prints question, table, literature and run time, and saves one picture;
its claims hold.
"""

from __future__ import annotations

import importlib.util
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).resolve().parents[2]
GALLERY = ROOT / "examples" / "gallery"
SHARED = ("build", "exhibit", "linear_loop")
SCRIPTS = sorted(path.stem for path in GALLERY.glob("*.py") if path.stem not in SHARED)
# below 1.5 s, nothing is compiled
QUICK = {"elbow", "flexible_link", "gears_and_friction", "index"}
LINES = 100


@pytest.fixture(scope="module", autouse=True)
def shared_module() -> Iterator[None]:
    sys.path.insert(0, str(GALLERY))
    yield
    sys.path.remove(str(GALLERY))


def loaded(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"gallery_{name}", GALLERY / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def table(output: str) -> dict[str, list[str]]:
    """Rows of the printed table by their first cell (a second one of a name: ``name'``); cells are
    two spaces apart.
    """
    rows = [
        re.split(r"\s{2,}", line.strip()) for line in output.splitlines() if line.startswith("  ")
    ]
    named: dict[str, list[str]] = {}
    for row in rows:
        if len(row) > 2:
            named[row[0] + "'" * sum(name.rstrip("'") == row[0] for name in named)] = row[1:]
    return named


def numbers(cells: list[str]) -> list[float]:
    return [float(cell) for cell in cells if re.fullmatch(r"[-+.\de]+", cell) and cell != "-"]


def check_elbow(rows: dict[str, list[str]]) -> None:
    for axis in ("q1", "q2"):  # rounding of torques of 6 kN m
        assert numbers(rows[axis])[-1] < 1e-8


def check_flexible_link(rows: dict[str, list[str]]) -> None:
    assert rows["4"][:4] == rows["exact"][:4]  # Euler-Bernoulli, three decimals


def check_gears_and_friction(rows: dict[str, list[str]]) -> None:
    for name in ("four_mass@low", "four_mass@high"):
        found = numbers(rows[name][:3])
        published = [float(x) for x in rows[name][3].split()]
        # printed with two decimals
        assert max(abs(a - b) for a, b in zip(found, published, strict=True)) < 0.006


def check_index(rows: dict[str, list[str]]) -> None:
    for name, cells in rows.items():
        if "/" not in cells[0] or name == "model":
            continue
        n_m, n_g, n_e = (int(x) for x in cells[0].split("/"))
        found = [int(x) for x in cells[1:6]]
        expected = {
            "elbow@rigid": [2, 3 * n_m, 2 * n_e, 3, 3],
            "planar5_nmp@undamped": [4, 5 * n_m, 2 * n_e, 5, 5],
        }.get(name, [3, 4 * n_m, n_g + 2 * n_e, 4, 4])
        assert found == expected, name


def check_kinematics(rows: dict[str, list[str]]) -> None:
    configurations = [
        cells for first, cells in rows.items() if re.fullmatch(r"-?\d+\.\d'*", first)
    ]
    assert len(configurations) == 8 and all(float(cells[-1]) < 1e-12 for cells in configurations)


def check_controllability(rows: dict[str, list[str]]) -> None:
    for name in ("elbow", "four_mass", "planar5_nmp", "manutec_r3"):
        states, rank, hautus = numbers(rows[name])[:3]
        assert states == rank and hautus > 1e-3


def check_minimum_phase(rows: dict[str, list[str]]) -> None:
    # two initial value methods, then the boundary value methods with intervals of 9 ms; torques up
    # to 24 N m
    assert (
        float(rows["kunkel-mehrmann"][0]) < 1e-5
        and float(rows["lq"][0]) < 5e-4
        and float(rows["bvp"][0]) < 5e-4
    )
    assert float(rows["bdf, order 1"][1]) > 100 * float(rows["bdf, order 3"][1])


def check_dae_solvers(rows: dict[str, list[str]]) -> None:
    # BDF has its order until rounding is differentiated too often; the others are accurate to
    # their tolerances
    assert (
        abs(float(rows["bdf, order 1"][3]) - 1) < 0.02
        and abs(float(rows["bdf, order 2"][3]) - 2) < 0.1
    )
    assert float(rows["bdf, order 3"][2]) > 5 * float(rows["bdf, order 3"][1])
    assert float(rows["kunkel-mehrmann"][2]) < 1e-5 and float(rows["reduced"][1]) < 1e-3


def check_non_minimum_phase(rows: dict[str, list[str]]) -> None:
    for constants in ("2", "4"):  # torque over the exponential of the zero
        assert all(abs(ratio - 1) < 0.01 for ratio in numbers(rows[constants])[3:5])


def check_models_compared(rows: dict[str, list[str]]) -> None:
    rigid, joints, static, extended = (
        numbers(rows[name])[0]
        for name in ("rigid", "flexible joints", "and static deflections", "extended")
    )
    assert rigid > joints > static > extended and extended < 0.01  # um


def check_identification(rows: dict[str, list[str]]) -> None:
    springs = [
        numbers(cells) for name, cells in rows.items() if name.endswith(("stiffness", "damping"))
    ]
    # sd, percent
    assert len(springs) == 6 and all(abs(cells[-1]) < 4 and abs(cells[3]) < 3 for cells in springs)


def check_benchmark_f(rows: dict[str, list[str]]) -> None:
    assert (
        0.7
        < numbers(rows["ppi_two_notches"])[0]
        < numbers(rows["ppi"])[0]
        < 1.0
        <= numbers(rows["reference"])[0]
    )


def check_benchmark_g(rows: dict[str, list[str]]) -> None:
    assert numbers(rows["ppi"])[0] < 0.5 < 1.0 <= numbers(rows["reference"])[0]


def check_feedback_linearization(rows: dict[str, list[str]]) -> None:
    worst = {
        name: float(cells[2]) for name, cells in rows.items() if name in ("motor PD", "FL", "LQ")
    }
    assert worst["LQ"] < worst["motor PD"] and worst["LQ"] < 0.6 * worst["FL"]
    assert float(rows["LQ"][1]) < 0.05  # mm: feedforward is exact for the model itself


def check_learning(rows: dict[str, list[str]]) -> None:
    for name in ("stiffness -20 %", "stiffness +20 %", "load +3 kg"):
        errors = numbers(rows[name])
        assert errors[-1] < 0.01 * errors[0]


def check_uncertain_robots(rows: dict[str, list[str]]) -> None:
    mean, largest = numbers(rows["error / simulated error - 1"])
    assert mean < 0.02 and largest < 0.05


def check_redundant_arm(rows: dict[str, list[str]]) -> None:
    names = ("carriage at rest", "carried by 0.3 m", "carried by 0.6 m")
    found = [numbers(rows[name]) for name in names]
    assert [cells[0] for cells in found] == [0.0, 0.3, 0.6]
    # the more the carriage does, the less the joints
    assert found[0][1] > found[1][1] > found[2][1]
    least, heavy = (numbers(rows[name])[0] for name in ("weight 1", "weight 25"))
    assert 0.0 < heavy < least
    assert len({rows[joint][0] for joint in ("rail", "q1", "q3")}) == 3  # the output moves zeros


def check_counterbalance(rows: dict[str, list[str]]) -> None:
    without = numbers(rows["without"])
    balanced = numbers(rows["with"])
    # at rest, in the move, RMS of the move
    assert all(x < 0.9 * y for x, y in zip(balanced, without, strict=True))


def check_elastic_rods(rows: dict[str, list[str]]) -> None:
    names = ("all springs", "rods 20 % softer", "rods rigid", "bearing rigid")
    largest = [numbers(rows[name])[0] for name in names]
    assert largest[0] < 0.1 < 50.0 < largest[1] < largest[2] < largest[3]  # um


def check_coupled_rotors(rows: dict[str, list[str]]) -> None:
    without, exact = zip(
        *(numbers(rows[name])[:2] for name in ("0.001", "0.0025", "0.01")), strict=True
    )
    assert 100.0 < without[0] < without[1] < without[2]  # um
    assert max(exact) < 0.1


CHECKS = {
    name.removeprefix("check_"): check
    for name, check in list(globals().items())
    if name.startswith("check_")
}


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[] if n in QUICK else pytest.mark.slow) for n in SCRIPTS]
)
def test_a_script_answers_its_question(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    script = loaded(name)
    import exhibit

    picture = exhibit.exhibit(
        script.__file__, script.QUESTION, script.LITERATURE, script.show, str(tmp_path)
    )
    output = capsys.readouterr().out
    assert output.startswith(f"{name}: {script.QUESTION}\n")
    assert re.search(r"^picture .*\.svg, [\d.]+ s$", output, re.MULTILINE)
    assert " ".join(script.LITERATURE.split()) in " ".join(output.split())
    assert [path.name for path in tmp_path.iterdir()] == [
        f"{name}.svg"
    ] and picture.stat().st_size > 5000
    assert ElementTree.parse(picture).getroot().tag.endswith("svg")
    CHECKS[name](table(output))


def test_every_script_is_short_and_on_the_page() -> None:
    page = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    listed = dict(re.findall(r"^\| \[(\w+)\]\([^)]*\) \| (.*) \|$", page, re.MULTILINE))
    assert listed == {name: loaded(name).QUESTION for name in SCRIPTS}
    assert set(CHECKS) == set(SCRIPTS)
    for name in SCRIPTS:
        assert len((GALLERY / f"{name}.py").read_text(encoding="utf-8").splitlines()) <= LINES


@pytest.mark.slow
def test_the_page_of_all_scripts_has_pictures_tables_and_run_times(
    tmp_path, monkeypatch, capsys
) -> None:
    """With two quick scripts, and one that fails: it is reported, and the others are there."""
    build = loaded("build")
    (tmp_path / "broken.py").write_text("raise SystemExit('broken')\n")
    scripts = [GALLERY / "elbow.py", tmp_path / "broken.py", GALLERY / "index.py"]
    monkeypatch.setattr(build, "scripts", lambda: scripts)
    assert build.build(tmp_path / "out") == 1
    page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert page.count("<img") == 2 and len(re.findall(r"Run time: [\d.]+ s\.", page)) == 2
    assert (
        "<h2>Elbow</h2>" in page and loaded("elbow").QUESTION in page and str(tmp_path) not in page
    )
    assert "broken: failed" in capsys.readouterr().err


def test_planted_numbers_are_found() -> None:
    """The checks read the tables that are printed, and fail for other numbers."""
    output = "  modes  1  2  3  4  zero\n  4      12.365  77.492  216.981  425.195  247.3\n"
    with pytest.raises(AssertionError):
        check_flexible_link(table(output + "  exact  12.365  77.492  216.981  430.000  -\n"))
    with pytest.raises(AssertionError):
        check_index(table("  planar5_nmp  2/2/1  3  8  3  4  4  C3  3e+11\n"))
