"""Bound of the operations of an update of a stream, for the public header.

It is linear in the number of intervals and of samples per interval, and follows the C in
``flexgen/codegen/clib/`` loop by loop, every loop with its largest number of passes; tests compare
it with the C. The bound of the memory is `StreamLayout.bound`.
"""

from __future__ import annotations

from collections.abc import Mapping

from flexgen.codegen.emission.size_terms import Linear
from flexgen.codegen.emission.stream_layout import (
    BLOCKS,
    CHAIN,
    EDGES,
    GROUP,
    HOLD_AFTER,
    HOLD_BEFORE,
    HOLD_DELAY_MAX,
    LAST,
    LEVELS,
    MARGIN,
    STAGES,
    Contents,
)

PANEL = 8
BACK = 2 * MARGIN
QP_STEPS = 80
AHEAD = HOLD_AFTER - 1 + HOLD_DELAY_MAX  # of a hold: samples ahead at most
TAPS = HOLD_BEFORE + 1 + HOLD_AFTER  # weights
CALL = 60  # operations of one call of sine and cosine, exp or tanh, at most
# evaluations of the output constraint while the kinematics are solved, at most
KINEMATIC_PASSES = 28
INVERSE_STEPS = 3  # refinements of an inverse before it is computed again
# evaluations of the gear law for one sample, at most
SPRING_PASSES = 8 + 1 + 200 + 60 + 1
RADAU_PASSES = 61
# of gears with hysteresis, of one sample, at most
BRANCH_PASSES = 500
LOCATIONS = 9 * 60
PIECES = 4  # of a friction with a state: steps in one sample
PARTS = 64  # at most


def _sizes(sizes: Mapping[str, int]) -> tuple[int, int, int, int, int, int]:
    n_a, n_g, n_e, n_m, n_y, n_t = (
        sizes[key] for key in ("n_a", "n_g", "n_e", "n_m", "n_y", "n_t")
    )
    return n_a, n_g, n_e, n_m, n_y, n_t


def stream_operations(
    sizes: Mapping[str, int], operations: Mapping[str, int], block: int, has: Contents
) -> Linear:
    """Additions, multiplications, divisions and comparisons of reals in one update, at most.

    ``operations``: of one point of each function that the inversion calls, with `CALL` for every
    call of the kernel.
    """
    n_a, n_g, n_e, n_m, n_y, n_t = _sizes(sizes)
    kinematics = _kinematics(sizes, operations["output_constraint"], block)
    rows = block * operations["inversion_rows"]
    gear = operations["gear_law"] + 16 * n_g
    friction = operations.get("motor_friction", 0)
    if "loaded_friction" in operations:
        friction = operations["loaded_friction"] + n_m * (2 * n_g + 1)
    # one instant of the path, interpolated, its small rotations included
    path = 600 + 40 * (n_t + 2 * n_y)
    motors = gear + friction + n_g * (8 * n_m + 60) + 8 * n_m
    if "motor_harmonics" in operations:
        motors += operations["motor_harmonics"] + 12 * n_m
    spring = SPRING_PASSES * gear
    radau = RADAU_PASSES * (3 * operations["gear_law"] + 120 * n_g) + 120 * n_g

    if has.elements:  # of hysteresis; lanes without gear too
        lanes = -(-n_g // block) * block
        radau = (
            BRANCH_PASSES
            * (3 * operations["gear_law"] + (3 * has.elements * (CALL + 30) + 110) * lanes)
            + LOCATIONS * 80 * lanes
        )
        if has.curved:  # a piece and its polynomial for each element; the path at each reversal
            radau += has.elements * n_g * (BRANCH_PASSES * 3 * 60 + 9 * 60 * 40)

    before, more, notches = has.filters
    ahead = AHEAD + MARGIN * has.bristles + more + BACK * has.stages
    if has.stages:  # a pass for each stage, and the motors after them
        coupling = operations["rotor_coupling"] + 4 * n_g * n_m + 40 * n_g
        motors += coupling
        spring = (1 + has.stages) * spring
        radau = (1 + has.stages) * radau
        motors += has.stages * (gear + coupling)
    # the window of samples around the interval, in groups of points; a guess that fails is made
    # again
    group = 2 * kinematics + rows + block * (path + 1500 + 60 * n_e + 12 * n_a)
    window = Linear(group * (2 * BACK + 1 + ahead + block) // block + group, 0, group // block + 1)
    window += Linear(0, 0, 1).times(
        spring + gear + radau + 3 * motors + 60 * (n_a + n_g * n_m + n_m)
    )
    window += Linear(600, 0, 2 * TAPS * n_m)  # hold: weights, and their use
    if has.position:  # of a sample of the servo: its recursion, and the joints
        window += Linear(20 * n_m, 0, 40 * n_m + 2 * n_g * n_m)
        window += Linear(
            more * 2 * TAPS * n_m, 0, (2 * TAPS + 3 * (before + more + 1) + 12 * notches) * n_m
        )
    window += Linear(2 * BACK + 2 + ahead, 0, 0).times(
        spring + gear + radau + motors + 60 * (n_a + n_g * n_m + n_m)
    )
    if has.bristles:  # parts, reversals of the speed, torques of a sample of a motor
        sample = n_m * (PIECES * PARTS * (3 * (CALL + 30) + 130) + 3 * 60 * 12 + 200 + 4 * n_g)
        window += Linear((ahead + 1) * sample, 0, sample)
    total = window + Linear(kinematics + block * path + 200 * n_g, 40 * (n_g + n_g * n_m + n_m), 0)

    total += _limits(sizes, kinematics + rows, path, spring + motors, block, has.bounds)
    if n_e:
        reduced = _count_reduced(sizes, operations["inversion_jacobians"], block)
        total += _lq(n_e, kinematics + reduced, kinematics + rows, block)
        levels = LEVELS * (kinematics + reduced + LAST * (2 * n_e**3 + 40 * n_e * n_e))
        total += Linear(levels + 4 * (2 * n_e) ** 2, 60 * n_e, 0)
        total += Linear(
            reduced + 4 * n_e**2 * (n_e + n_y) + 20 * (n_g + n_e) * n_y * (n_e + n_g), 0, 0
        )
    return total


def _kinematics(sizes: Mapping[str, int], constraint: int, block: int) -> int:
    """Operations of solve_kinematics for a block of instants."""
    n_a, n_g, _, _, n_y, n_t = _sizes(sizes)
    inverse = n_y * (n_y * (4 + 12 * n_y) + 2 * n_y + 4 * n_y * n_y + 8)
    step = n_g * (2 * n_y + 6) + 4 * (n_y + n_t)
    refined = INVERSE_STEPS * (4 * n_y**3 + 6 * n_y * n_y + 8 * n_y + 4)
    rates = 3 * (n_y * (2 * n_a + 2) + 2 * n_g * n_y + 4 * n_g) + 2 * n_a
    return block * (
        KINEMATIC_PASSES * (constraint + refined + inverse + step) + constraint + rates
    )


def _count_reduced(sizes: Mapping[str, int], jacobians: int, block: int) -> int:
    """Operations of the Jacobians of the reduced problem at a block of instants."""
    _, n_g, n_e, _, n_y, _ = _sizes(sizes)
    products = 4 * n_e * n_g * n_y * 2 + 4 * n_e * n_y * n_g * 2
    return block * (jacobians + products + n_e * n_e * n_g * 14 + n_e * (3 * n_e + 1) + 2 * n_e)


def _lq(n_e: int, point_group: int, row_group: int, block: int) -> Linear:
    """Operations of a Gauss-Newton step over the horizon, with ``n_e`` coordinates without motor
    (2 n_e states).

    ``point_group``: operations of a ``block`` of Gauss points with Jacobians; ``row_group``: of
    one without.
    """
    states = 2 * n_e
    controls = STAGES * n_e
    width = (controls + states + block) // block * block
    tall = controls + states + 9
    residual_rows = controls * (STAGES + 2) * 5 * (n_e + 15) + 60 * STAGES
    outer = 2 * controls * tall * width
    cost = n_e * (STAGES * (controls * 14 + n_e * 16) + 40 * n_e + 60) + 40 * STAGES
    elimination = outer + controls * width * (2 * PANEL + 4)
    step = 2 * controls * (width + 17) + 60 * n_e + 10 * controls
    gradient = (
        STAGES * n_e * (6 * (n_e + 6) + 40) + 2 * controls * (width + 8) + 60 * n_e + 4 * width
    )
    interval = residual_rows + outer + cost + elimination + step + gradient + 4 * states * states
    groups = -(-GROUP * STAGES // block)
    all_points = point_group + row_group
    return Linear(
        groups * all_points + 4 * states * states + 400,
        groups * all_points // GROUP + 1 + interval,
        0,
    )


def _count_bounded(sizes: Mapping[str, int], bounds: bool) -> int:
    """Limited quantities at a node, and deviations."""
    _, n_g, n_e, n_m, n_y, _ = _sizes(sizes)
    return 2 * n_m + n_y + bounds * (n_m + 3 * n_g + n_e + 2)


def _limits(
    sizes: Mapping[str, int], group: int, path: int, motors: int, block: int, bounds: bool
) -> Linear:
    """Operations that limits of motors add, for each node of the horizon and once.

    ``group``: operations of motion and torques at a ``block`` of nodes; ``path``, ``motors``: of
    the path and of the motors at one instant; ``bounds``: the model has bounds of torques and
    speeds.
    """
    n_a, n_g, _, n_m, n_y, _ = _sizes(sizes)
    bounded = _count_bounded(sizes, bounds)
    n = BLOCKS * n_y
    node = group // block + 1 + motors + 20 * (n_a + bounded) + (1 + STAGES) * (path + 300)
    node += (
        BLOCKS * CHAIN * 8 * CHAIN
        + CHAIN * BLOCKS * n_y * (4 + 4 * BLOCKS)
        + CHAIN * n_y * BLOCKS * 4
    )
    node += bounded * (n * (10 + 2 + 1 + n) + 40)  # rows of the program, scaled, and their squares
    node += bounded * QP_STEPS * (4 * n + 24)
    node += bounds * (n_m * EDGES * 12 + bounded * n * (40 + 12 * n_y))
    once = (
        group * (2 + -(-n_g // block))
        + motors
        + 4 * n * n * n
        + QP_STEPS * (4 * n * n + 8 * n)
        + 400 * n_y
    )
    once += n_g * n_y * (8 * n_g + 20 * n_m) + path
    return Linear(once + node, node, 8 * n_m)
