"""A generated library as Python functions on numpy arrays: `load`. Needs numpy and the manifest,
nothing else.

Many points are fastest as a structure of arrays, and fastest of all with memory for the results::

    q_a = np.empty(
        (n, 3), order="F"
    )  # all first coordinates, then all second ones: read where they are
    M = np.empty((n, 3, 3), order="F")
    robot.mass_matrix(q_a, out=M)  # the work of C and a few microseconds
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from flexgen.runtime.calls import Function
    from flexgen.runtime.identity import ABI_VERSION, FORMAT
    from flexgen.runtime.library import Library, load

__all__ = ["ABI_VERSION", "FORMAT", "Function", "Library", "load"]


def __getattr__(name: str) -> Any:
    """The names of the package; imported here, since compilers of modules need only a part of the
    package.
    """
    if name not in __all__:
        raise AttributeError(f"module 'flexgen.runtime' has no attribute {name!r}")
    from flexgen.runtime import identity, library

    return getattr(library if hasattr(library, name) else identity, name)
