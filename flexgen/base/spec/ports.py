"""Ports: the one place where the name, shape, unit and meaning of every array is written.

The C header's comments, the manifest, the Python wrapper's checks, the channels of a trajectory
and the printed tables are all rendered from ports, so that they cannot disagree.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from flexgen.base.checks.type_checks import checked_result
from flexgen.base.errors import ArgumentError

_IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,30}\Z")

CPP_KEYWORDS = frozenset(
    """
    alignas alignof and and_eq asm auto bitand bitor bool break case catch char char8_t char16_t \
char32_t class
    compl concept const consteval constexpr constinit const_cast continue co_await co_return \
co_yield decltype
    default delete do double dynamic_cast else enum explicit export extern false float for friend \
goto if inline
    int long mutable namespace new noexcept not not_eq nullptr operator or or_eq private \
protected public register
    reinterpret_cast requires return short signed sizeof static static_assert static_cast struct \
switch
    template this thread_local throw true try typedef typeid typename union unsigned using \
virtual void volatile
    wchar_t while xor xor_eq
    """.split()
)
# Reserved by C++20, C11, or the headers of the C library that a user of the emitted code is likely
# to include.
_RESERVED = CPP_KEYWORDS | frozenset(
    """
    restrict typeof main errno NULL EOF stdin stdout stderr
    acos acosh asin asinh atan atan2 atanh cbrt ceil copysign cos cosh erf erfc exp exp2 expm1 \
fabs fdim floor fma
    fmax fmin fmod frexp hypot ilogb ldexp lgamma log log10 log1p log2 logb modf nan nearbyint \
nextafter pow
    remainder rint round scalbn sin sinh sqrt tan tanh tgamma trunc j0 j1 jn y0 y1 yn gamma signgam
    abort abs atexit atof atoi atol bsearch calloc div exit free getenv index labs malloc memcmp \
memcpy memmove
    memset printf puts qsort rand random read realloc rindex signal sleep sprintf srand strcmp \
strcpy strlen
    strncpy system time clock write open close link
    """.split()
)


def identifier_problem(text: str) -> str | None:
    """Why ``text`` may not be a name in a model file, or None where it may.

    A name is a letter, then at most 30 letters, digits or underscores, without a double
    underscore. Names of joints, motors, elements and moves are never identifiers of their own in
    the emitted C (they stand in comments, in texts and behind a prefix): ``j1`` and ``y0``,
    functions of libm, are good names. See `c_name_problem` for the others.
    """
    if not _IDENTIFIER.match(text):
        return "a letter followed by at most 30 letters, digits or underscores"
    if "__" in text:
        return "a name without a double underscore"
    return None


def c_name_problem(text: str) -> str | None:
    """Why ``text`` may not be an identifier in the emitted C, or None where it may.

    For the names of libraries, functions and arrays: an identifier that is neither a keyword of C
    or C++ nor a name of the C library.
    """
    problem = identifier_problem(text)
    if problem is None and text in _RESERVED:
        problem = "a name that is not reserved by C, C++ or the C library"
    return problem


@checked_result
@dataclass(frozen=True)
class Port:
    """One array that crosses an interface.

    Parameters
    ----------
    name : str
        Identifier in Python and C.
    shape : tuple of int
        ``(n,)`` for a vector, ``(rows, columns)`` for a matrix (stored by columns).
    unit : str
        SI unit, such as ``"rad/s"``; ``"mixed"`` where the rows differ, with the doc saying how.
    doc : str
        What it is, in one line.

    Examples
    --------
    >>> library = flexgen.load(flexgen.generate("elbow", functions=["gravity"]).directory)
    >>> (port,) = library.gravity.inputs
    >>> port.name, port.shape, port.unit
    ('q_a', (2,), 'rad')
    """

    name: str
    shape: tuple[int, ...]
    unit: str
    doc: str

    def __post_init__(self) -> None:
        problem = c_name_problem(self.name)
        if problem is not None:
            raise ArgumentError(f"port name: given {self.name[:80]!r}, expected {problem}")
        if len(self.shape) not in (1, 2) or any(n < 0 for n in self.shape):
            raise ArgumentError(
                f"port {self.name}: given shape {self.shape}, expected one or two sizes >= 0"
            )

    @property
    def size(self) -> int:
        """Number of entries."""
        n = 1
        for m in self.shape:
            n *= m
        return n
