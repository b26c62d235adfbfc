"""The equations of motion of a model as CasADi functions: the table of all functions, and
`derive`.
"""

from __future__ import annotations

import hashlib
import pickle
import textwrap
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from flexgen.base.checks.counts import show_value
from flexgen.base.checks.type_checks import checked_class, checked_types
from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics import dynamics, inversion_functions, linearization
from flexgen.dynamics.mechanics.signatures import (
    FLEXIBLE_JOINT,
    FUNCTIONS,
    INVERSION,
    PYTHON_TABLE,
    TABLE,
    offered_functions,
    reference,
    split_product,
)
from flexgen.dynamics.mechanics.system import Builder, Built, ImplicitDae, System
from flexgen.model.elements import Element, RobotModel
from flexgen.model.reader import read


def _flexible_joint(name: str) -> Builder:
    """The builder of a function of arms with elastic joints, whose module a solution does not
    need.
    """

    def build(system: System) -> Built:
        from flexgen.dynamics.mechanics import flexible_joint

        return flexible_joint.BUILDERS[name](system)

    return build


BUILDERS: dict[str, Builder] = (
    dynamics.BUILDERS
    | linearization.BUILDERS
    | inversion_functions.BUILDERS
    | {name: _flexible_joint(name) for name in FLEXIBLE_JOINT}
)

# Rows of the functions in the docstring of the equations.
_DESCRIBED = [row for row in (*TABLE, *PYTHON_TABLE) if row.name in BUILDERS]


@checked_class
@dataclass(frozen=True, init=False, eq=False, repr=False)
class Equations(System):  # noqa: D101, its docstring is made from the table
    __doc__ = f"""Equations of motion of one model; each function is built when it is first used.

    `function` gives these functions, with sizes as in the model, SI units, and arm quantities on \
the arm side::

{textwrap.indent(reference(_DESCRIBED), 8 * " ")}

    ``NAME_jvp`` and ``NAME_vjp`` are products with the derivatives of a function: see \
`flexgen.dynamics.mechanics.products`.
    ``x = (q_a, q_me, v_a, v_me)`` with ``q_me`` the motors behind elastic gears. Entries of \
``q_m``, ``v_m``, ``a_m``
    behind rigid gears are ignored as inputs (they follow their joints) and returned filled in. \
``r`` (n): residual of
    the equations of motion in ``y = (q_a, q_me)``.

    Functions of equations with ``parameters`` (names: see \
`flexgen.dynamics.mechanics.parameters`) have \
these as a last argument
    where they depend on them. ``model`` keeps the numbers, ``with_symbols`` has the symbols in \
their place.

    Examples
    --------
    >>> equations = flexgen.derive("elbow")
    >>> mass_matrix = equations.function("mass_matrix")  # of CasADi
    >>> mass_matrix([0.0, 0.0]).shape
    (2, 2)
    """

    def __repr__(self) -> str:
        symbols = f", {len(self.parameters)} parameters as symbols" if self.parameters else ""
        return f"<Equations {self.model.title}: {self.model.dof} degrees of freedom{symbols}>"

    def __reduce__(self) -> tuple[type[Equations], tuple[RobotModel, tuple[str, ...]]]:
        """Pickled as the model and the names of its parameters; the functions are built again
        where they are used.
        """
        return Equations, (self.model, tuple(parameter.name for parameter in self.parameters))

    @cached_property
    def _functions(self) -> dict[str, ca.Function]:
        """Functions by name that were built so far."""
        return {}

    @cached_property
    def pushed(self) -> Equations:
        """Copy with symbols for a force on the tool, the argument ``f_tool`` (6,) of all functions
        it changes.
        """
        return self.with_force(ca.SX.sym("f_tool", 6))

    def touching(self, contact: ca.Function) -> Equations:
        """Copy as by `pushed`, with the force of a wall from ``q_a``, ``v_a`` in a simulation."""
        return self.with_force(ca.SX.sym("f_tool", 6), contact)

    def pushed_by(self, force: np.ndarray | None) -> Equations:
        """Copy with a constant force and torque (6,) on the tool; the same object for None."""
        if force is not None and (np.shape(force) != (6,) or not np.isfinite(force).all()):
            raise ArgumentError(
                f"force: given {show_value(force)}, expected 6 finite numbers, force [N], "
                "torque [N m]"
            )
        return self if force is None else self.with_force(ca.SX(ca.DM(force)))

    def with_force(self, force: ca.SX, contact: ca.Function | None = None) -> Equations:
        """Copy with a force on the tool, and that of a wall, with symbols of its own.

        Parameters
        ----------
        force : casadi.SX (6,)
            Symbols or numbers: force [N], torque [N m], at the origin of the tool, world axes.
        contact : casadi.Function, optional
            Adds a force (6,) from ``q_a`` and ``v_a`` in a simulation.

        Returns
        -------
        Equations
        """
        made = Equations(self.model, [parameter.name for parameter in self.parameters])
        return made._with_parts(force=force, contact=contact)

    def with_memory(self, more: ca.SX, memory: ca.SX) -> Equations:
        """Copy with further forces (n,) on y, expressions in the symbols of the Lagrangian and in
        ``memory``.

        ``memory`` is an argument of all functions it changes.
        """
        lagrangian = self.lagrangian
        # the forces stand in none of them
        unchanged = ("y", "left", "mass", "arm_left")
        built = {name: part for name, part in vars(self).items() if name in unchanged}
        built["lagrangian"] = replace(lagrangian, forces=lagrangian.forces + more)
        return self._with_parts(memory=memory, **built)

    def with_elements(self, elements: Sequence[Element]) -> Equations:
        """Copy whose model with symbols has other elements, in the same symbols."""
        return self._with_parts(with_symbols=replace(self.with_symbols, elements=tuple(elements)))

    def function(self, name: str) -> ca.Function:
        """The CasADi function of that name (see the class); ArgumentError for an unknown one."""
        if name not in self._functions:
            base, kind = split_product(name)
            if base not in BUILDERS:
                raise ArgumentError(
                    f"function: given {name!r}, expected one of {', '.join(BUILDERS)}"
                )
            built = BUILDERS[base](self)
            if kind:
                from flexgen.dynamics.mechanics.products import (
                    differentiated,  # (a solution needs none)
                )

                built = differentiated(self, kind, built)
            self._functions[name] = self.build(name, *built)
        return self._functions[name]

    def sizes(self, progress: Callable[[str], None] | None = None) -> dict[str, int]:
        """Number of instructions of each function that the model has, by its name.

        ``progress`` gets a line before each function that is built.
        """
        missing = {*INVERSION, *FUNCTIONS} - set(offered_functions(self.model))
        names = [name for name in BUILDERS if name not in missing]
        found = {}
        for k, name in enumerate(names, 1):
            if progress is not None:
                progress(f"deriving function {k} of {len(names)}: {name}")
            found[name] = int(self.function(name).n_instructions())
        return found

    def dae(self) -> ImplicitDae:
        """The equations of motion as one implicit DAE ``F(xdot, x, z, u) = 0`` with names and
        units.

        ``x = (q_a, q_me, v_a, v_me)``, ``z`` = (gear torques, output), ``u = tau_m``; see
        `flexgen.dynamics.mechanics.implicit_dae`.
        """
        from flexgen.dynamics.mechanics.implicit_dae import implicit_dae

        return implicit_dae(self)


def robot_of(model: str | Path | RobotModel | Equations) -> RobotModel:
    """The robot of a model that is given by its name, its file, as it was read, or by its
    equations.
    """
    if isinstance(model, Equations):
        return model.model
    return model if isinstance(model, RobotModel) else read(model)


@checked_types
def derive(model: str | Path | RobotModel, parameters: Sequence[str] = ()) -> Equations:
    """Equations of motion of a model.

    Parameters
    ----------
    model : str, Path or RobotModel
        A name in models/, a path (either with ``@variant``), or a model that was read before.
    parameters : sequence of str
        Numbers of the model that stay symbols; names as in
        `flexgen.dynamics.mechanics.parameters`.

    Returns
    -------
    Equations

    Raises
    ------
    ModelError, ArgumentError
        Where the model cannot be read.

    Examples
    --------
    >>> flexgen.derive("elbow").model.dof
    4
    """
    return Equations(model if isinstance(model, RobotModel) else read(model), parameters)


# Equations of the last models, by the digests of the models.
_KEPT: dict[bytes, Equations] = {}
# Models that are kept; each takes some megabytes.
KEPT = 4


class _OwnParts(pickle.Pickler):
    """Refuses laws of other packages, which may change between two calls, as in a notebook.

    Of a data class the fields only: properties that it keeps once they are used make no other
    model.
    """

    def reducer_override(self, part: Any) -> Any:
        if not type(part).__module__.startswith(("flexgen.", "builtins", "numpy", "pathlib")):
            raise pickle.PicklingError(type(part).__module__)
        if is_dataclass(part) and not isinstance(part, type):
            return type(part), tuple(getattr(part, field.name) for field in fields(part))
        return NotImplemented


def model_digest(robot: RobotModel) -> bytes | None:
    """Digest of the fields of a model; None where it has laws of other packages.

    Models have one digest where their pickles are equal, in which -0.0 is not 0.0.
    """
    text = BytesIO()
    pickler = _OwnParts(text)
    # two objects that are equal have one text, also where they share parts in other ways
    pickler.fast = True
    try:
        pickler.dump(robot)
    except (pickle.PicklingError, AttributeError, TypeError):
        return None
    return hashlib.sha256(text.getbuffer()).digest()


def kept_equations(robot: RobotModel) -> Equations:
    """As `derive`, but the same object again for one of the last models: for callers that return
    none of it.

    Only the main thread keeps equations: CasADi releases the lock of the interpreter, and two
    threads must not build functions from one graph.
    """
    digest = model_digest(robot)
    if digest is None or threading.current_thread() is not threading.main_thread():
        return Equations(robot)
    # the last one used is the last one in the table
    made = _KEPT.pop(digest, None) or Equations(robot)
    _KEPT[digest] = made
    while len(_KEPT) > KEPT:
        del _KEPT[next(iter(_KEPT))]
    return made
