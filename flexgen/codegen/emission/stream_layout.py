"""The memory of a stream, stated once: the head of `flexgen.runtime.streams.head`, then arrays of
reals.

`flexgen.codegen.emission.stream_header` writes these rows as C, with the function that places the
arrays; `StreamLayout` computes the same sizes and positions as integers, and the bound of the
public header. Sizes that are those of hand-written C, such as ``WIDTH``, stand in `names_of`; the
emitted header compares them when it is compiled.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from flexgen.codegen.emission.interface import DELAY_MAX
from flexgen.codegen.emission.size_terms import Linear, Name, Term, pad, pad_at_most
from flexgen.runtime.streams.head import HEAD, POSITION, head_offsets

# Reals in 64 bytes: arrays are padded to so many, and so many points are evaluated together.
BLOCK = {"double": 8, "single": 16}
BYTES = {"double": 8, "single": 4}  # of a real
STAGES = 3  # Gauss points of an interval
GROUP = 8  # intervals that are evaluated together
MARGIN = 3  # samples on either side that a derivative needs
CHAIN = 5  # a deviation and its derivatives
HOLD_BEFORE = 4  # samples before that of a held torque that it depends on
HOLD_AFTER = 5  # and after it; the delay comes on top
HOLD_DELAY_MAX = DELAY_MAX  # samples
LEVELS = 3  # of the quasi-static motion
LAST = 5  # nodes of the path, for differences
BLOCKS = 8  # of constant input over the horizon, at most
EDGES = 20  # of the torque-speed curve of a motor, at most
SWINGS = 5  # numbers of the Fourier sums of a motor

# What a row may need: a part of the library, or coordinates without motor.
ELASTIC = "ELASTIC"
BOUNDS = "BOUNDS"
COUPLED = "COUPLED"
HARMONICS = "HARMONICS"
HYSTERESIS = "HYSTERESIS"
LUGRE = "LUGRE"
FILTERS = "FILTERS"


@dataclass(frozen=True)
class Row:
    """An array, or a constant of C.

    Parameters
    ----------
    name : str
    size : Term or int
        Reals of the array; value of the constant.
    doc : str
    needs : str
        The part without which there is no such array; empty: it is always there.
    """

    name: str
    size: Term | int
    doc: str = ""
    needs: str = ""


NA = Name("NA")
NG = Name("NG")
NE = Name("NE")
NM = Name("NM")
NY = Name("NY")
REFERENCE = Name("REFERENCE")
DEVIATION = Name("DEVIATION")
STATES = Name("STATES")
CONTROLS = Name("CONTROLS")
WIDTH = Name("WIDTH")
_STAGES = Name("STAGES")
_MARGIN = Name("MARGIN")
_BLOCK = Name("BLOCK")

BACK = Name("BACK")
BRANCH = Name("BRANCH")
BOUNDED = Name("BOUNDED")
INPUTS = Name("INPUTS")
LIMITS_SIZE = "limits_laid_out(intervals).end"  # reals of the arrays of the limits, in C
# Variables of the function that places the arrays.
INTERVALS = Name("intervals")
SAMPLES = Name("samples_per_interval")
AHEAD = Name("ahead")  # samples after those of an update that held torques depend on
HELD = Name("held")  # 1 where there are any, else 0
WINDOW = Name("window")  # samples: before, of an update and its end, ahead
PAST = Name("past")  # intervals before the horizon that are kept

# Constants of C that the sizes of the arrays depend on.
CONSTANTS = (
    Row("BACK", 2 * _MARGIN, "samples around those of an update that its derivatives need"),
    Row("REACH", Name("COUPLING_STAGES") * BACK, "samples more, for stages of motors", COUPLED),
    Row("LEVELS", LEVELS, "levels of the quasi-static motion"),
    Row("LAST", LAST, "last nodes of the path, for differences"),
    Row("JOINT", 3 * NG, "position, speed and acceleration of the joints with motor"),
    Row("OUTPUT", 2 * NA + NG + 3 * NM, "numbers of the results at a sample"),
    Row("MEASURES", 4, "scales of the kinematic mismatch, see kinematic_mismatch_now"),
    Row("BLOCKS", BLOCKS, "of constant input over the horizon, at most"),
    Row("INPUTS", Name("BLOCKS") * NY, ""),
    Row("RATE_ROWS", 2 * NM, "after torques and speeds of motors: rates of torques", BOUNDS),
    Row("GEAR_ROWS", Name("RATE_ROWS") + NM, "torques of gears", BOUNDS),
    Row("ELASTIC_ROWS", Name("GEAR_ROWS") + NG, "deflections", BOUNDS),
    Row("JOINT_ROWS", Name("ELASTIC_ROWS") + NE, "speeds and accelerations of joints", BOUNDS),
    Row("TOOL_ROWS", Name("JOINT_ROWS") + 2 * NG, "speed and acceleration of the tool", BOUNDS),
    Row("MOTORS", Name("TOOL_ROWS") + 2, "limited quantities at a node", BOUNDS),
    Row("EDGES", EDGES, "of the torque-speed curve of a motor, at most", BOUNDS),
    Row("MOTORS", 2 * NM, "torques and speeds of motors at a node", f"not {BOUNDS}"),
    Row("BOUNDED", Name("MOTORS") + NY, "and deviations"),
    Row("SWINGS", SWINGS, "numbers of a motor, see find_swings", HARMONICS),
)
NODES = INTERVALS + 1
ROWS = NODES * BOUNDED
# Arrays of the limits, from the place of ``limits`` on.
LIMIT_ARRAYS = (
    Row("bound", BOUNDED, "the limits"),
    Row("plan", NODES * REFERENCE, "the given path"),
    Row("deviation", NODES * DEVIATION, "from it, with derivatives"),
    Row("value", ROWS, "limited quantities relative to their limits"),
    Row("q", NODES * NG, "planned motion and torques of the arm at the nodes"),
    Row("v", NODES * NG),
    Row("a", NODES * NG),
    Row("tau", NODES * NG),
    Row("still", NODES * NG, "torques where no rotor moves", COUPLED),
    Row("deflection", NODES * NG, "of the gears, without damping"),
    Row("lagged", NODES * NG, "with it"),
    Row("response", NODES * Name("CHAIN") * Name("BLOCKS"), "of the deviation to unit inputs"),
    Row("H", INPUTS * INPUTS, "the quadratic program, see qp"),
    Row("g", INPUTS),
    Row("A", ROWS * INPUTS),
    Row("x", ROWS),
    Row("y", ROWS),
    Row("z", INPUTS),
    Row("K", INPUTS * INPUTS),
    Row("w", ROWS),
    Row("vv", ROWS),
    Row("b", INPUTS),
    Row("dual", ROWS, "multipliers, kept from update to update"),
    Row("swing", NM * Name("SWINGS"), "largest numbers of the Fourier sums", HARMONICS),
    Row("curve", 2 * NM * Name("EDGES"), "edges: torque at rest, and what a speed takes", BOUNDS),
    Row("torque", NODES * NM, "motor torques without friction", BOUNDS),
    Row("elastic", NODES * NE, "deflections at the nodes", BOUNDS),
    Row("edge", NODES * 2 * NM, "derivatives of the used part of a torque", BOUNDS),
)
_STAGES_AHEAD = INTERVALS * _STAGES
_KEPT = PAST + INTERVALS
_MORE_SAMPLES = SAMPLES + AHEAD
# The arrays of a stream, from ``HEAD`` on.
ARRAYS = (
    Row("limits", Name(LIMITS_SIZE), "limits, and the deviation"),
    Row("output", SAMPLES * Name("OUTPUT"), "results of an update"),
    Row("last", REFERENCE, "sample of the path at the end of the horizon"),
    Row("tau", WINDOW * NG, "torques of the gears in the window"),
    Row("deflection", WINDOW * NG, "of the gears, without damping"),
    Row("lagged", WINDOW * NG, "with damping"),
    Row("still", WINDOW * NG, "torques of the gears where no rotor moves", COUPLED),
    Row("arm", WINDOW * (3 * NA), "motion of the arm in the window", COUPLED),
    Row("coupled", WINDOW * NG, "forces of the moving rotors on the joints", COUPLED),
    Row("now", BRANCH * NG, "the gears as they are kept, see keep_branches", HYSTERESIS),
    Row("now", NG, "deflections of the gears now", f"not {HYSTERESIS}"),
    Row("joint", WINDOW * Name("JOINT"), "motion of the joints in the window"),
    Row(
        "bristles",
        Name("BRISTLES") + (_MORE_SAMPLES + 2 * _MARGIN) * NM,
        "numbers of the bristles, then their impulses",
        LUGRE,
    ),
    Row("motion", (_MORE_SAMPLES + 1) * 2 * NM, "speeds, accelerations of the motors", LUGRE),
    Row("most", Name("MEASURES") + NM, "largest values lately, of measures and torques"),
    Row("expected", NM + NG, "motor torques and gear deflections that the last plan predicted"),
    Row("q_g", (_STAGES_AHEAD + 1) * NG, "joints; the last ones: at the start of the horizon"),
    Row("reference", _STAGES_AHEAD * REFERENCE, "the path at the Gauss points"),
    Row("nodes", (_KEPT + 1) * REFERENCE, "the path at the nodes"),
    Row("y", (_KEPT + 1) * STATES, "states at the nodes", ELASTIC),
    Row("a", _KEPT * CONTROLS, "accelerations in the intervals", ELASTIC),
    Row("a_node", (_KEPT + 1) * NE, "accelerations at the nodes", ELASTIC),
    Row("factor", INTERVALS * CONTROLS * WIDTH, "of the intervals", ELASTIC),
    Row("point", _STAGES_AHEAD * Name("POINT") + _BLOCK, "data of the factors", ELASTIC),
    Row("costs", INTERVALS * STATES * STATES, "costs to go of their first nodes", ELASTIC),
    Row("row", _STAGES_AHEAD * NE, "residuals", ELASTIC),
    Row("linear", INTERVALS * CONTROLS, "right sides of the factors", ELASTIC),
    Row("scale", NE, "of the residuals", ELASTIC),
    Row("levels", Name("LEVELS") * Name("LAST") * NE, "of the quasi-static motion", ELASTIC),
    Row("cost", STATES * STATES, "to go, of the horizon before", ELASTIC),
    Row("target_state", NODES * STATES, "at the nodes", ELASTIC),
    Row("lq", Name("STEP_SPACE"), "of a step, only within a call: lq_space or problem_points"),
    Row("space", Name("FUNCTION_SPACE"), "workspace of functions, parameters, force"),
    Row("servo", Name("SERVO_NUMBERS"), "see servo.h", POSITION),
    Row("command", SAMPLES * (NM + NG), "positions to send", POSITION),
    Row(
        "sent",
        (Name("FILTER_BEFORE") + SAMPLES + Name("FILTER_AHEAD")) * NM,
        "torques to send",
        FILTERS,
    ),
    Row(
        "torque",
        HELD * (Name("HOLD_BEFORE") + SAMPLES + AHEAD + 1) * NM,
        "motor torques that held ones depend on",
    ),
)


def layout_text() -> str:
    """Names and sizes of all members and arrays, in one line."""
    members = [f"{member.kind} {member.name}[{member.count}]" for member in HEAD]
    rows = [
        f"{row.name}({row.size.c() if isinstance(row.size, Term) else row.size})"
        for row in (*CONSTANTS, *LIMIT_ARRAYS, *ARRAYS)
    ]
    return " ".join([*members, *rows])


@dataclass(frozen=True)
class Contents:
    """Contents of a stream: elements of hysteresis in a gear, some by other laws than Dahl's;
    positions to send, frictions with a state, all limits, Fourier sums of motor angles; of filters
    of a servo samples before the present one, after it, and notches; numbers of the force on the
    output with its derivatives; stages of motors in complete coupling.
    """

    elements: int
    curved: bool
    position: bool
    bristles: bool
    bounds: bool
    harmonics: bool
    filters: tuple[int, int, int]
    forces: int = 0
    stages: int = 0

    def parts(self, elastic: bool) -> frozenset[str]:
        """The parts that rows may need; ``elastic``: with coordinates without motor."""
        has = {
            ELASTIC: elastic,
            BOUNDS: self.bounds,
            COUPLED: self.stages > 0,
            HARMONICS: self.harmonics,
            HYSTERESIS: self.elements > 0,
            LUGRE: self.bristles,
            POSITION: self.position,
            FILTERS: any(self.filters),
        }
        return frozenset(name for name in has if has[name])


@dataclass(frozen=True)
class StreamLayout:
    """Sizes and positions of the memory of a stream.

    Parameters
    ----------
    sizes : mapping of str to int
        Of the library: ``n_a``, ``n_g``, ``n_e``, ``n_m``, ``n_y``, ``n_t``.
    precision : str
        ``"double"`` or ``"single"``.
    has : Contents
    function_work : int
        Reals of workspace of the functions that it calls, with the run-time parameters.

    Examples
    --------
    >>> plain = Contents(0, False, False, False, False, False, (0, 0, 0))
    >>> sizes = {"n_a": 2, "n_g": 2, "n_e": 0, "n_m": 2, "n_y": 2, "n_t": 2}
    >>> layout = StreamLayout(sizes, "double", plain, 8)
    >>> layout.head["tolerance"], layout.head["state"]  # bytes
    (8, 80)
    >>> layout.offsets(10, 5)["limits"]  # reals
    24
    """

    sizes: Mapping[str, int]
    precision: str
    has: Contents
    function_work: int

    @property
    def block(self) -> int:
        """Reals that arrays are padded to."""
        return BLOCK[self.precision]

    def rows(self, table: tuple[Row, ...]) -> list[Row]:
        """The rows of a table that this stream has."""
        return [
            row
            for row in table
            if not row.needs
            or (row.needs.removeprefix("not ") in self.parts) != row.needs.startswith("not ")
        ]

    @property
    def parts(self) -> frozenset[str]:
        """The parts of the library that its rows may need."""
        return self.has.parts(self.sizes["n_e"] > 0)

    @property
    def head(self) -> dict[str, int]:
        """Position of each member of the head, in bytes."""
        return head_offsets(BYTES[self.precision], self.parts)[0]

    @property
    def head_size(self) -> int:
        """Reals before the arrays."""
        width = BYTES[self.precision]
        return pad(head_offsets(width, self.parts)[1] // width, self.block)

    def given(self) -> dict[str, int]:
        """Constants of hand-written C that the sizes depend on, as they have to be there."""
        n_a, n_g, n_e, n_m, n_y, n_t = (
            self.sizes[key] for key in ("n_a", "n_g", "n_e", "n_m", "n_y", "n_t")
        )
        names = {"NA": n_a, "NG": n_g, "NE": n_e, "NM": n_m, "NY": n_y, "STAGES": STAGES}
        names |= {"MARGIN": MARGIN, "BLOCK": self.block, "CHAIN": CHAIN}
        names |= {"DEVIATION": CHAIN * n_y, "HOLD_BEFORE": HOLD_BEFORE, "HOLD_AFTER": HOLD_AFTER}
        names |= {"REFERENCE": n_t + 2 * n_y + self.has.forces}
        if n_e:
            columns = STAGES * n_e + 2 * n_e + 1
            names |= {"STATES": 2 * n_e, "CONTROLS": STAGES * n_e}
            names |= {"WIDTH": pad(columns, self.block), "POINT": n_e * (3 * n_e + 1)}
        if self.has.stages:
            names |= {"COUPLING_STAGES": self.has.stages}
        if self.has.elements:
            names |= {"BRANCH": 3 + self.has.elements}
        if self.has.bristles:
            names |= {"BRISTLES": 2 * n_m, "PAST_IMPULSES": MARGIN * n_m}
        if self.has.position:
            names |= {"SERVO_NUMBERS": 3 + (10 + 4 * self.has.filters[2]) * n_m}
        if any(self.has.filters):
            before, after, notches = self.has.filters
            names |= {"FILTER_BEFORE": before, "FILTER_AHEAD": after, "NOTCHES": notches}
        return names

    def constants(self) -> dict[str, int]:
        """All constants that the sizes depend on."""
        names = self.given()
        names |= {"STEP_SPACE": self.step_space, "FUNCTION_SPACE": self.function_work}
        for row in self.rows(CONSTANTS):
            names[row.name] = _integer(row.size, names)
        return names

    @property
    def step_space(self) -> int:
        """Reals of the struct ``lq_space``, or ``problem_points`` where all coordinates have
        motors.
        """
        names = self.given()
        n_a, n_g, n_e, n_y = (self.sizes[key] for key in ("n_a", "n_g", "n_e", "n_y"))
        points = 3 * n_a + self.sizes["n_t"] + 2 * n_y + n_y + n_a * n_y + n_y + n_y * n_g + 2
        points += n_g + (self.has.forces > 0) * n_y
        if not n_e:
            return self.block * points
        points += n_e + 3 * n_a * n_e + 3 * n_a * n_y + 4 * n_e * n_g + n_e * n_y + 3 * n_e * n_e
        columns = names["CONTROLS"] + names["STATES"] + 1
        width = names["WIDTH"]
        point = names["POINT"]
        states = names["STATES"]
        many = max(GROUP * STAGES * point, STAGES * point + columns * width)
        rows = names["CONTROLS"] * width + self.block
        return self.block * points + many + rows + (columns + 1) * width + states * states + states

    def ahead(self, hold: bool, delay: float) -> int:
        """Samples after those of an update that its torques depend on; ``hold``: they are held."""
        held = HOLD_AFTER - 1 + int(delay) if hold or delay > 0 else 0
        if held and any(self.has.filters):
            held += self.has.filters[1]
        return held + MARGIN * self.has.bristles

    @property
    def reach(self) -> int:
        """Samples of the window more, for stages of motors."""
        return 2 * MARGIN * self.has.stages

    def variables(self, intervals: int, samples: int, ahead: int) -> dict[str, int]:
        """Variables that the sizes of the arrays depend on; ``samples``: per interval, ``ahead``:
        behind the interval, which hold and delay need.
        """
        back = 2 * MARGIN
        return {
            "intervals": intervals,
            "samples_per_interval": samples,
            "ahead": ahead,
            "held": int(ahead > 0),
            "window": 2 * back + samples + 1 + ahead + self.reach,
            "past": max((back + samples - 1) // samples + 1, LAST - 1),
        }

    def offsets(
        self, intervals: int, samples: int, hold: bool = False, delay: float = 0.0
    ) -> dict[str, int]:
        """Position of each array of a stream in reals, and ``end``, the length of its memory;
        ``hold``: torques are held over a sample, ``delay``: of the motors [samples].
        """
        names = self.constants() | self.variables(intervals, samples, self.ahead(hold, delay))
        names[LIMITS_SIZE] = self.limit_offsets(intervals)["end"]
        return self._place(ARRAYS, names, self.head_size)

    def limit_offsets(self, intervals: int) -> dict[str, int]:
        """Position of each array of the limits, from the first one on, and ``end``."""
        return self._place(LIMIT_ARRAYS, self.constants() | {"intervals": intervals}, 0)

    def _place(self, table: tuple[Row, ...], names: Mapping[str, int], at: int) -> dict[str, int]:
        found = {}
        for row in self.rows(table):
            found[row.name] = at
            at = at + pad(_integer(row.size, names), self.block)
        return found | {"end": at}

    def bound(self) -> Linear:
        """Length of the memory, at most, for each hold and delay."""
        names: dict[str, int | Linear] = {
            **self.constants(),
            **self.variables(1, 1, self.ahead(True, HOLD_DELAY_MAX)),
        }
        samples = Linear(0, 0, 1)
        names |= {"intervals": Linear(0, 1), "samples_per_interval": samples}
        around = 4 * MARGIN + 1 + self.ahead(True, HOLD_DELAY_MAX) + self.reach
        names |= {"window": samples + around}
        names[LIMITS_SIZE] = self._bound(LIMIT_ARRAYS, names)
        return self._bound(ARRAYS, names) + self.head_size

    def _bound(self, table: tuple[Row, ...], names: Mapping[str, int | Linear]) -> Linear:
        total = Linear(0)
        for row in self.rows(table):
            size = row.size if isinstance(row.size, int) else row.size.value(names)
            total += pad_at_most(size, self.block)
        return total


def _integer(size: Term | int, names: Mapping[str, int]) -> int:
    """The value of a size whose names are all integers."""
    found = size if isinstance(size, int) else size.value(names)
    assert isinstance(found, int)
    return found
