"""Cases of a sweep, and the grid of models, parameters, moves and methods that they are taken
from.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.checks.counts import CASES, RANDOM_MOVES, count_of, show_value
from flexgen.base.checks.type_checks import checked_class, checked_types
from flexgen.base.display import short_repr
from flexgen.base.errors import ArgumentError, FlexgenError
from flexgen.base.spec.arguments import mapping_of
from flexgen.codegen.emission.digest import model_digest
from flexgen.model.elements import Move, RobotModel
from flexgen.model.reader import read
from flexgen.paths.timing.time_laws import TimeLaw

OPTIONS = (
    "preview",
    "mesh",
    "verify",
    "accuracy",
    "time_limit",
    "ignore_limits",
    "fixed_joint",
    "options",
    "batch",
)  # of flexgen.solve, and one of the sweep
SPAN = {"rad": np.pi, "m": 0.5}  # largest coordinate of random moves where the model has no limits
MARGIN = 1e-3  # relative distance of random moves from limits of speed and acceleration


@checked_class
@dataclass(frozen=True)
class RandomMove:
    """A joint move drawn at random within the model's limits of position, speed and acceleration.

    It is the same for the same ``number`` and ``seed`` on every computer. ``duration`` [s],
    ``smoothness``: of a Move.

    Examples
    --------
    >>> (move,) = flexgen.random_moves(1, seed=1, duration=0.8)
    >>> move
    RandomMove(number=0, seed=1, duration=0.8, smoothness=5)
    >>> flexgen.Grid(["elbow"], moves=[move], methods=["auto"])[0].move
    RandomMove(number=0, seed=1, duration=0.8, smoothness=5)
    """

    number: int
    seed: int = 0
    duration: float = 1.0
    smoothness: int = 5

    def of(self, model: RobotModel) -> Move:
        """The move of one model."""
        draw = np.random.default_rng([self.seed, self.number]).random((2, model.n_g))
        speed, acceleration = _peaks(self.smoothness)
        start = []
        end = []
        for (first, second), i in zip(draw.T, model.i_g, strict=True):
            coordinate = model.coordinates[i]
            dof = coordinate.dof
            span = SPAN[coordinate.unit]
            assert dof is not None  # it is actuated
            low = -span if dof.lower is None else dof.lower
            high = span if dof.upper is None else dof.upper
            way = high - low
            if dof.speed_max is not None:
                way = min(way, (1 - MARGIN) * dof.speed_max * self.duration / speed)
            if dof.acceleration_max is not None:
                way = min(
                    way, (1 - MARGIN) * dof.acceleration_max * self.duration**2 / acceleration
                )
            start.append(float(low + (high - low) * first))
            lowest = max(low, start[-1] - way)
            highest = min(high, start[-1] + way)
            end.append(float(lowest + (highest - lowest) * second))
        name = f"random{self.number}"
        return Move(name, "joint", tuple(start), self.duration, self.smoothness, end=tuple(end))


@cache
def _peaks(smoothness: int) -> tuple[float, float]:
    """Largest speed and acceleration of the time law of one second."""
    s = np.abs(TimeLaw(1.0, smoothness)(np.linspace(0.0, 1.0, 2001), 2))
    return float(s[:, 1].max()), float(s[:, 2].max())


@checked_types(own=("count",))
def random_moves(
    count: int, seed: int = 0, duration: float = 1.0, smoothness: int = 5
) -> tuple[RandomMove, ...]:
    """Random joint moves within the ranges, speeds and accelerations of the model, for the cases
    of a `Grid`.

    Parameters
    ----------
    count : int
        At most a million.
    seed : int
        Of the random numbers; a move depends on the seed and its number only.
    duration : float [s]
    smoothness : int
        Of the time law, as in a model file.

    Returns
    -------
    tuple of RandomMove

    Raises
    ------
    ArgumentError
        A number is out of range.

    Examples
    --------
    >>> moves = flexgen.random_moves(3, seed=1, duration=0.8)
    >>> len(flexgen.Grid(["elbow", "planar5_nmp"], moves=moves, methods=["auto"]))
    6
    """
    count = count_of("count", count, RANDOM_MOVES, 0)
    return tuple(RandomMove(number, seed, duration, smoothness) for number in range(count))


MoveChoice = str | Move | RandomMove | None
ModelChoice = str | Path | RobotModel


@dataclass(frozen=True)
class Case:
    """One solve of a sweep: ``number`` in its grid, model, changes of the model, move (None: its
    first) and method.
    """

    number: int
    model: ModelChoice
    parameters: Mapping[str, Any]
    move: MoveChoice
    method: str

    def robot(self) -> RobotModel:
        """The model with its changes; raises the errors of `flexgen.read`."""
        if not isinstance(self.model, RobotModel):
            return read(self.model, overrides=self.parameters)
        if self.parameters:
            raise ArgumentError(
                f"sweep: given parameters for the RobotModel {self.model.name}, expected the "
                "name or file of a model"
            )
        return self.model


@checked_class
@dataclass(frozen=True)
class Grid:
    """Grid of a sweep: all combinations, models slowest, then parameter sets, moves and, fastest,
    methods.

    Parameters
    ----------
    models : sequence of names, paths or RobotModel
        As `flexgen.solve` takes them, variants included.
    moves : sequence of str, Move, RandomMove or None
        None: the first move of the model.
    methods : sequence of str
    parameters : sequence of mappings
        Changes of the model file, dotted paths to values, as in `flexgen.read`; `combinations`
        makes them of lists.
    options : mapping
        The same for all cases: ``preview``, ``mesh``, ``verify``, ``accuracy``, ``time_limit``
        (default: none), ``ignore_limits``, ``fixed_joint``, ``options`` of `flexgen.solve`, and
        ``batch``: compute joint moves in closed form in batches where that is possible and
        ``verify`` is False.

    Cases are made on access: ``grid[17]``, ``len(grid)``, ``for case in grid``.

    Examples
    --------
    >>> grid = flexgen.Grid(["elbow", "planar5_nmp"], moves=["line", "joints"], methods=["lq"])
    >>> len(grid), grid[1].move
    (4, 'joints')
    """

    models: Sequence[ModelChoice]
    moves: Sequence[MoveChoice] = (None,)
    methods: Sequence[str] = ("auto",)
    parameters: Sequence[Mapping[str, Any]] = ({},)
    options: Mapping[str, Any] = field(default_factory=dict)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        kinds: dict[str, tuple[Any, str]] = {
            "models": ((str, Path, RobotModel), "names, paths or models"),
            "moves": ((str, Move, RandomMove, type(None)), "names, moves or None"),
            "methods": (str, "names"),
            "parameters": (Mapping, "mappings of dotted paths to values"),
        }
        for name, (kind, what) in kinds.items():
            values = getattr(self, name)
            if isinstance(values, str | Mapping) or not isinstance(values, Sequence):
                raise ArgumentError(
                    f"grid, {name}: given {values!r}, expected a sequence of {what}"
                )
            if not values or not all(isinstance(value, kind) for value in values):
                raise ArgumentError(
                    f"grid, {name}: given {list(values)[:5]!r}, expected one or more {what}"
                )
            object.__setattr__(self, name, tuple(values))
        cases = math.prod(self._sizes)
        if cases > CASES:
            raise ArgumentError(
                f"grid: given {cases} cases, expected at most {CASES}; split it into several "
                "sweeps"
            )
        unknown = sorted(set(self.options) - set(OPTIONS))
        if unknown:
            raise ArgumentError(
                f"grid, options: given {unknown[0]!r}, expected some of {', '.join(OPTIONS)}"
            )

    @property
    def _sizes(self) -> tuple[int, ...]:
        return len(self.models), len(self.parameters), len(self.moves), len(self.methods)

    def __len__(self) -> int:
        return math.prod(self._sizes)

    def __getitem__(self, number: int) -> Case:
        if not 0 <= number < len(self):
            raise IndexError(f"case {number} of {len(self)}")
        model, parameters, move, method = (int(k) for k in np.unravel_index(number, self._sizes))
        return Case(
            number,
            self.models[model],
            self.parameters[parameters],
            self.moves[move],
            self.methods[method],
        )

    def __iter__(self) -> Iterator[Case]:
        return (self[number] for number in range(len(self)))

    def describe(self) -> dict[str, Any]:
        """The grid as JSON types; models with a digest of their data."""
        return {
            "models": [
                {"model": _describe(model), "digest": _content(model)} for model in self.models
            ],
            "parameters": [_to_json(changes) for changes in self.parameters],
            "moves": [_to_json(move) for move in self.moves],
            "methods": list(self.methods),
            "options": _to_json(self.options),
        }

    @cached_property
    def digest(self) -> str:
        """SHA-256 of everything that the results depend on, except the code."""
        text = json.dumps(self.describe(), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()


@checked_types(own=("values",))
def combinations(values: Mapping[str, Sequence[Any]]) -> tuple[dict[str, Any], ...]:
    """All combinations of the listed values as parameter sets, the last key fastest.

    Parameters
    ----------
    values : mapping of str to sequence
        Values of each dotted path of the model file.

    Returns
    -------
    tuple of dict
        ``parameters`` of a `Grid`: changes of the model file, see ``overrides`` of `flexgen.read`.

    Raises
    ------
    ArgumentError
        Not a mapping to lists with values, or too many combinations.

    Examples
    --------
    >>> for changes in flexgen.combinations(
    ...     {"motor.m1.inertia": [0.01, 0.02], "motor.m2.inertia": [0.01]}
    ... ):
    ...     print(changes)
    {'motor.m1.inertia': 0.01, 'motor.m2.inertia': 0.01}
    {'motor.m1.inertia': 0.02, 'motor.m2.inertia': 0.01}
    """
    for key, listed in mapping_of(
        "values", values, "a mapping of names to lists of values"
    ).items():
        if isinstance(listed, str) or not isinstance(listed, Sequence) or not listed:
            raise ArgumentError(
                f"parameters {key}: given {show_value(listed)}, expected a list of values"
            )
    sets = math.prod(map(len, values.values()))
    if sets > CASES:
        raise ArgumentError(f"parameters: given {sets} combinations, expected at most {CASES}")
    return tuple(dict(zip(values, chosen, strict=True)) for chosen in product(*values.values()))


def _describe(model: ModelChoice) -> str:
    return model.name if isinstance(model, RobotModel) else str(model)


def _content(model: ModelChoice) -> str:
    try:
        robot = model if isinstance(model, RobotModel) else read(model)
    except FlexgenError as error:  # its cases report it
        return f"unreadable: {error}"
    return " ".join([model_digest(robot), *(_samples(move) for move in robot.moves if move.file)])


def _samples(move: Move) -> str:
    """SHA-256 of the file with the samples of a move."""
    try:
        return hashlib.sha256(Path(move.file).read_bytes()).hexdigest()
    except OSError as error:
        return f"unreadable: {error.strerror}"


def _to_json(value: Any) -> Any:
    """JSON types; data classes with their names."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        parts = {
            part.name: _to_json(getattr(value, part.name))
            for part in dataclasses.fields(value)
            if part.compare
        }
        if isinstance(value, Move) and value.file:
            parts["samples"] = _samples(value)
        return {type(value).__name__: parts}
    if isinstance(value, Mapping):
        return {str(key): _to_json(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _to_json(value.tolist())
    if isinstance(value, list | tuple):
        return [_to_json(item) for item in value]
    return value if value is None or isinstance(value, bool | int | float | str) else repr(value)
