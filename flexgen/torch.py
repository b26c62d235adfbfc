"""The functions of a library in PyTorch: `functions`. On the CPU, with gradients in both modes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import BuildError
from flexgen.runtime.library import Library

if TYPE_CHECKING:
    from flexgen.backends.autodiff.points import Functions


@checked_types
def functions(library: Library) -> Functions:
    """The functions of a loaded library for PyTorch.

    Tensors have the shapes of the library's functions on numpy arrays, after any axes of a batch;
    a tensor without these axes is the same for all points. ``parameters``, where the library has
    any, are those of the model by default. Results have the library's precision. Gradients are
    those of ``NAME_jvp`` and ``NAME_vjp``, which ``parts=["derivatives"]`` of `flexgen.generate`
    adds. Where an input or result is not finite, the results of the point are NaN.

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
        The library was closed.
    BuildError
        PyTorch is not installed, or there is no C compiler.
    """
    try:
        from flexgen.backends.autodiff.torch_functions import functions_of
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        raise BuildError(
            "torch: given none, expected the package torch; pip install 'flexgen-robotics[torch]'"
        ) from None
    return functions_of(library)
