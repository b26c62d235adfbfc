"""The public function `check`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from flexgen.analysis.linear import linearize, poles
from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import FlexgenError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.registry import provides
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.statics import Equilibrium, hold_joints
from flexgen.model.elements import RobotModel
from flexgen.studies.check.finding import ERROR, Check, Finding
from flexgen.studies.check.moves import moves
from flexgen.studies.check.numbers import bodies, drives, report_overdamped, sizes, springs

SLOW = 2.0 * np.pi  # 1/s: slower real poles are friction of the free joints


@checked_types
def check(model: str | Path | RobotModel | Equations, *, motions: bool = True) -> Check:
    """Compare the numbers of a model with those of real robots: wrong units, powers of ten, moves
    beyond limits.

    Parameters
    ----------
    model : name, path, RobotModel or Equations
    motions : bool
        Also check the range and the speeds of each move, and springs and motors at its poses.

    Returns
    -------
    Check
        ``print(check)`` shows unusual numbers; ``check.findings`` has all numbers.

    Raises
    ------
    ModelError, ArgumentError
        The model file has an error.

    Examples
    --------
    >>> flexgen.check("elbow").errors
    ()
    """
    return _compare(model if isinstance(model, Equations) else derive(model), motions)


@provides("Check.implausible")
def implausible_number(model: str | Path | RobotModel | Equations) -> str:
    """The worst error of a model, as the end of the message of a computation that failed; empty
    where there is none.
    """
    try:
        worst = _compare(
            model if isinstance(model, Equations) else derive(model), motions=False
        ).worst
    except (FlexgenError, ArithmeticError, ValueError):
        return ""
    return "" if worst is None else f"; numbers of the model are implausible: {worst}"


def _compare(equations: Equations, motions: bool) -> Check:
    """All findings on a model: numbers of the file, equilibrium and poles at home, and with
    ``motions`` those of its moves.

    Without an equilibrium the drives are judged at the undeflected home pose, and poles are left
    out.
    """
    robot = equations.model
    findings = [*sizes(robot), *bodies(robot)]
    home = np.asarray(robot.home, dtype=float)
    try:
        rest = hold_joints(equations, home)
    except FlexgenError as error:
        advice = "stiffness of the springs without motor, masses, gravity"
        findings.append(
            Finding(ERROR, "home", "equilibrium at home", str(error), "one", advice, 9.0)
        )
        q_a = np.zeros(robot.n_a)
        none_m = np.zeros(robot.n_m)
        none_g = np.zeros(robot.n_g)
        q_a[list(robot.i_g)] = home
        rest = Equilibrium(q_a, none_m, none_m, none_g)
    M = evaluate(equations.function("mass_matrix"), rest.q_a)[0].reshape(robot.n_a, robot.n_a)
    findings += [*drives(robot, M, rest), *springs(robot, M, rest)]
    if not any(finding.key == "home" for finding in findings):
        findings.append(report_overdamped(poles(linearize(equations, rest)), SLOW))
    if motions:
        findings += moves(equations, findings)
    return Check(robot.title, tuple(findings))
