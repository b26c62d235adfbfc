"""The functions of a library in JAX: `functions`. On the CPU, under jit, vmap, scan, grad, jacfwd
and jacrev.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import BuildError
from flexgen.runtime.library import Library

if TYPE_CHECKING:
    from flexgen.backends.autodiff.points import Functions


@checked_types
def functions(library: Library) -> Functions:
    """The functions of a loaded library for JAX.

    Arrays have the shapes of the library's functions on numpy arrays, after any axes of a batch;
    an array without these axes is the same for all points. ``parameters``, where the library has
    any, are those of the model by default. Gradients are those of ``NAME_jvp`` and ``NAME_vjp``,
    which ``parts=["derivatives"]`` of `flexgen.generate` adds. Where an input or result is not
    finite, the results of the point are NaN.

    Parameters
    ----------
    library : Library
        Of `flexgen.load`.

    Returns
    -------
    Functions
        With the library's functions as attributes, such as
        ``functions(library).inverse_dynamics(q_a, v_a, a_a)``.

    Raises
    ------
    ArgumentError
        The library is in double precision and JAX is not, or the library was closed.
    BuildError
        JAX is not installed, or there is no C compiler.
    """
    try:
        from flexgen.backends.autodiff.jax_functions import functions_of
    except ModuleNotFoundError as error:
        if not (error.name or "").startswith("jax"):
            raise
        raise BuildError(
            "jax: given none, expected the package jax; pip install 'flexgen-robotics[jax]'"
        ) from None
    return functions_of(library)
