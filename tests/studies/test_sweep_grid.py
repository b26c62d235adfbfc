"""Content of a sweep: the order of its cases, the digest of its content, random moves, and grid
files.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sweep_grids import ONE, ROBOTS, real_grid

from flexgen.base.errors import ArgumentError
from flexgen.model.moves import Move
from flexgen.model.reader import read
from flexgen.paths.timing.time_laws import TimeLaw
from flexgen.studies.sweeps.cases import Case, Grid, RandomMove, combinations, random_moves
from flexgen.studies.sweeps.folder import default_size
from flexgen.studies.sweeps.grid_file import read_grid
from flexgen.studies.sweeps.jobs import Job

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "sweep.toml"


def test_cases_have_one_order() -> None:
    grid = Grid(["a", "b"], ("x", "y"), ["m", "n"], [{"k": 1}, {"k": 2}])
    assert len(grid) == 16 == len(list(grid))
    assert [
        (c.model, c.parameters["k"], c.move, c.method)
        for c in (grid[0], grid[1], grid[2], grid[4], grid[8])
    ] == [
        ("a", 1, "x", "m"),
        ("a", 1, "x", "n"),
        ("a", 1, "y", "m"),
        ("a", 2, "x", "m"),
        ("b", 1, "x", "m"),
    ]
    assert [case.number for case in grid] == list(range(16))
    for number in (-1, 16):
        with pytest.raises(IndexError, match=f"case {number} of 16"):
            grid[number]
    assert combinations({"p": [1, 2], "q": [3, 4]}) == (
        {"p": 1, "q": 3},
        {"p": 1, "q": 4},
        {"p": 2, "q": 3},
        {"p": 2, "q": 4},
    )


def test_the_digest_is_of_the_content(tmp_path) -> None:
    text = (ROBOTS / "one.toml").read_text(encoding="utf-8")
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "one.toml").write_text(text, encoding="utf-8")
    grid = real_grid()
    assert grid.digest == real_grid().digest
    same = replace(grid, models=(read(ONE),))
    assert same.describe()["models"][0]["digest"] == grid.describe()["models"][0]["digest"]
    changed = text.replace("inertia = 1e-4", "inertia = 1.1e-4").replace(
        "inertia = 1.0e-4", "inertia = 1.1e-4"
    )
    digests = {grid.digest}
    (tmp_path / "first" / "one.toml").write_text(changed, encoding="utf-8")
    other = [
        replace(grid, models=(str(tmp_path / "first" / "one.toml"),)),
        # it has the same content, but another name
        replace(grid, models=(str(tmp_path / "second" / "one.toml"),)),
        replace(grid, methods=("auto",)),
        replace(grid, moves=(None, RandomMove(4))),
        replace(grid, options={}),
        replace(grid, parameters=grid.parameters[:1]),
    ]
    digests |= {one.digest for one in other}
    assert len(digests) == 7
    contents = [one.describe()["models"][0]["digest"] for one in other[:2]]
    assert changed != text and contents[0] != contents[1] == grid.describe()["models"][0]["digest"]


def accelerations(bound: float | None) -> np.ndarray:
    """Largest accelerations of random moves (50, n_g): those of the time law by differences, times
    the way.
    """
    model = read("manutec_r3")
    changed = [
        replace(e, dofs=tuple(replace(d, acceleration_max=bound) for d in e.dofs))
        for e in model.elements
    ]
    t = np.linspace(0.0, 2.0, 4001)
    largest = np.abs(np.gradient(np.gradient(TimeLaw(2.0, 4)(t, 0)[:, 0], t), t)).max()
    moves = [
        move.of(replace(model, elements=tuple(changed)))
        for move in random_moves(50, 3, 2.0, smoothness=4)
    ]
    return np.abs([np.subtract(move.end, move.start) for move in moves]) * largest


def test_random_moves_keep_the_largest_acceleration_where_it_is_the_only_limit() -> None:
    assert accelerations(None).max() > 4.0 > 2.0 > accelerations(2.0).max() > 1.6


def test_random_moves_keep_the_limits() -> None:
    model = read("manutec_r3")
    moves = [move.of(model) for move in random_moves(50, seed=2, duration=0.7, smoothness=4)]
    assert moves == [
        move.of(model) for move in random_moves(50, seed=2, duration=0.7, smoothness=4)
    ]
    assert len({move.start for move in moves}) == 50
    s = np.abs(TimeLaw(0.7, 4)(np.linspace(0, 0.7, 501), 2)).max(axis=0)
    ways = np.abs([np.subtract(move.end, move.start) for move in moves])
    dofs = [c.dof for c in model.coordinates if c.dof is not None]
    speeds, accelerations = (
        [getattr(dof, name) for dof in dofs] for name in ("speed_max", "acceleration_max")
    )
    assert (ways * s[1] < speeds).all() and (ways * s[2] < accelerations).all()
    # and use them
    assert (np.maximum(ways * s[1] / speeds, ways * s[2] / accelerations).max(axis=0) > 0.8).all()
    narrow = read(
        "elbow",
        overrides={"element.upper.dof.q1.lower_rad": 0.0, "element.upper.dof.q1.upper_rad": 1.0},
    )
    ends = np.array([move.of(narrow).end[0] for move in random_moves(50)])
    assert (ends >= 0).all() and (ends <= 1).all() and np.ptp(ends) > 0.5


@pytest.mark.parametrize("name", ["elbow", "manutec_r3", "urdf_arm"])
def test_random_moves_are_those_of_their_numbers(name: str) -> None:
    """Draws of NumPy's generator by seed and number, the same on every computer: start in the
    range, way by the limits of position, speed and acceleration, of rotations and translations.
    """
    robot = read(name)
    made = RandomMove(3, 5, 0.5, 4)
    move = made.of(robot)
    draw = np.random.default_rng([5, 3]).random((2, robot.n_g))
    s = np.abs(TimeLaw(0.5, 4)(np.linspace(0, 0.5, 2001), 2)).max(axis=0)
    for k, i in enumerate(robot.i_g):
        dof = robot.coordinates[i].dof
        largest = {"rad": np.pi, "m": 0.5}[robot.coordinates[i].unit]
        low = -largest if dof.lower is None else dof.lower
        high = largest if dof.upper is None else dof.upper
        ways = [high - low, 0.999 * (dof.speed_max or np.inf) / s[1]]
        way = min(*ways, 0.999 * (dof.acceleration_max or np.inf) / s[2])
        start = low + (high - low) * draw[0, k]
        first = max(low, start - way)
        last = min(high, start + way)
        assert move.start[k] == pytest.approx(start)
        assert move.end[k] == pytest.approx(first + (last - first) * draw[1, k])
    assert (move.name, move.duration, move.smoothness, move.type) == ("random3", 0.5, 4, "joint")
    assert [m.number for m in random_moves(3, 1, 2.0, 6)] == [0, 1, 2] and random_moves(0) == ()


def test_cases_are_named_in_the_table() -> None:
    named = Move("m", "joint", (0.0,), 1.0, 5, end=(1.0,))
    cases = [
        Case(4, "elbow", {"b": 1, "a": 2}, RandomMove(9), "auto"),
        Case(0, read("elbow"), {}, named, "lq"),
        Case(1, "x", {}, None, "lq"),
        Case(2, "x", {}, "line", "lq"),
    ]
    rows = [list(Job.of(case, "key").heading.values()) for case in cases]
    assert rows == [
        [4, "elbow", '{"a": 2, "b": 1}', "random9", "auto"],
        [0, "elbow", "", "m", "lq"],
        [1, "x", "", "", "lq"],
        [2, "x", "", "line", "lq"],
    ]
    with pytest.raises(ArgumentError, match="given parameters for the RobotModel elbow"):
        Case(0, read("elbow"), {"a": 1}, None, "auto").robot()


def test_a_grid_is_described_with_its_models_and_the_samples_of_its_moves(tmp_path: Path) -> None:
    """A sweep continues only where all of it is the same: a changed file of samples is another
    grid.
    """
    file = tmp_path / "path.csv"
    move = Move("along", "sampled", (0.1, 0.2), 1.0, 5, file=str(file))
    robot = replace(read("elbow"), moves=(move,))
    values = [{"payload.mass": np.float64(2.0)}, {"motor.m1.ratio": np.array([3, 4])}]
    grid = Grid(["elbow", "none"], [None, "line", move], ["lq"], values, {"mesh": None})
    digests = []
    for text in ("t s,x m\n0,0\n", "t s,x m\n0,1\n"):
        file.write_text(text)
        grid = replace(grid)
        told = grid.describe()
        samples = hashlib.sha256(file.read_bytes()).hexdigest()
        own = Grid([robot]).describe()["models"][0]
        assert told["moves"][2]["Move"]["samples"] == samples == own["digest"].split()[1]
        assert told["moves"][2]["Move"]["start"] == [0.1, 0.2] and own["model"] == "elbow"
        digests.append((grid.digest, samples, own["digest"].split()[0]))
    assert digests[0][0] != digests[1][0] and digests[0][2] == digests[1][2]
    assert told["parameters"] == [{"payload.mass": 2.0}, {"motor.m1.ratio": [3, 4]}]
    assert (told["options"], told["moves"][:2]) == ({"mesh": None}, [None, "line"])
    missing = told["models"][1]
    assert missing["model"] == "none" and missing["digest"].startswith("unreadable: model: given ")
    file.unlink()
    gone = Grid([robot]).describe()["models"][0]["digest"]
    assert gone.endswith(" unreadable: No such file or directory")


SIZES = {1: 1, 639: 9, 640: 10, 6400: 16}


@pytest.mark.parametrize("cases", SIZES)
def test_shards_have_a_sixty_fourth_of_the_cases_and_not_too_many(cases: int) -> None:
    assert default_size(Grid(["x"] * cases)) == SIZES[cases]
    batch = Grid(["x"] * 64_000, options={"batch": True})
    assert default_size(batch) == 512


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"models": []}, "one or more names"),
        ({"models": "elbow"}, "expected a sequence"),
        ({"methods": [1]}, "one or more names"),
        ({"moves": [3]}, "names, moves or None"),
        ({"parameters": {"a": 1}}, "expected a sequence"),
        ({"options": {"speed": 1}}, "expected some of preview"),
    ],
)
def test_invalid_grids_are_refused(change, text) -> None:
    with pytest.raises(ArgumentError, match=text):
        Grid(**({"models": ["elbow"]} | change))


def test_more_cases_and_moves_than_can_be_computed_are_refused() -> None:
    with pytest.raises(
        ArgumentError, match="count: given 1000000000, expected a whole number from 0 to 1000000"
    ):
        random_moves(10**9)
    with pytest.raises(ArgumentError, match="count: given an integer of 33220 bits"):
        random_moves(10**10000)
    moves = random_moves(1000)
    with pytest.raises(
        ArgumentError, match="grid: given 100000000 cases, expected at most 10000000; split it"
    ):
        Grid(["elbow"] * 1000, moves, ["lq"] * 100)


def test_grid_files(tmp_path) -> None:
    file = tmp_path / "grid.toml"
    file.write_text(
        'models = ["elbow"]\n'
        'moves = ["line"]\n'
        'methods = ["auto", "full"]\n'
        "[random]\n"
        "count = 2\n"
        "seed = 7\n"
        "[parameters]\n"
        '"motor.m1.inertia" = [1e-3, 2e-3]\n'
        "[options]\n"
        "verify = false\n",
        encoding="utf-8",
    )
    grid = read_grid(file)
    assert grid.moves == ("line", *random_moves(2, 7)) and len(grid) == 12
    assert grid[6].parameters == {"motor.m1.inertia": 2e-3} and grid.options == {"verify": False}
    file.write_text('models = ["a"]\n[parameters]\na.b = [1, 2]\n', encoding="utf-8")
    assert read_grid(file).parameters == ({"a.b": 1}, {"a.b": 2})
    file.write_text(
        'models = ["a"]\n[[set]]\n"a.b" = 1\n[[set]]\n"a.b" = 2\nc = 3\n', encoding="utf-8"
    )
    assert read_grid(file).parameters == ({"a.b": 1}, {"a.b": 2, "c": 3})
    example = read_grid(EXAMPLE)
    assert len(example) == 18 and all(case.robot().name == case.model for case in example)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("models = [", "not TOML"),
        ('models = ["a"]\nspeed = 1', "2:speed: given an unknown key"),
        ("methods = []", "models"),
        ('models = ["a"]\nrandom = 3', "2:random: given 3, expected a table"),
        (
            'models = ["a"]\n[random]\ncount = 1.5',
            "3:random.count: given 1.5, expected a whole number",
        ),
        (
            'models = ["a"]\n[random]\ncount = 1\nduration = -1',
            "4:random.duration: given -1, expected a number > 0, at most 86400",
        ),
        (
            'models = ["a"]\n[random]\ncount = 1\ncolour = 1',
            "4:random.colour: given an unknown key",
        ),
        ('models = ["a"]\n[parameters]\n"x" = 3', "a list of values"),
        ('models = ["a"]\nparameters = 3', "expected a table"),
        ('models = ["a"]\n[parameters]\nx = [3]\n[[set]]\nx = 1', "given both, expected either"),
        ('models = ["a"]\nset = 3', "2:set: given 3, expected a list of tables"),
        ('models = ["a"]\nmoves = 3', "2:moves: given 3, expected a list of names"),
        (
            'models = ["a"]\n[random]\ncount = 4294967296',
            "random.count: given 4294967296, .* from 0 to 1000000",
        ),
        ('models = ["a"]\n[random]\ncount = 1\nduration = 1e400', "random.duration: given inf"),
        (
            f'models = ["a"]\n[random]\ncount = {"9" * 400}',
            "toml:3:file: given a whole number of 1329 bits",
        ),
        (
            f'models = ["a"]\n[parameters]\nx = [0x{"f" * 4400}]',
            "toml:3:file: .* 17600 bits, expected at most",
        ),
        (f'models = ["a"]\n[random]\ncount = {"9" * 4400}', "not TOML .exceeds the limit"),
        (
            'models = ["a"]\n[parameters]\n'
            + "".join(f"p{k} = {list(range(50))}\n" for k in range(6)),
            "15625000000 comb",
        ),
        ('models = ["a"]\nx = ' + "[" * 3000 + "]" * 3000, "nested too deeply"),
    ],
)
def test_wrong_grid_files_are_refused(tmp_path, text, reason) -> None:
    file = tmp_path / "grid.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ArgumentError, match=reason) as error:
        read_grid(file)
    assert str(file) in str(error.value)
    with pytest.raises(ArgumentError, match="cannot be read"):
        read_grid(tmp_path)
