"""Named parts of a vector of unknowns."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Self

import numpy as np


@dataclass(frozen=True)
class Layout:
    """Base of layouts: a subclass has one field of type slice for each part of its vector.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> from flexgen.identification.estimator.layout import Layout
    >>> @dataclass(frozen=True)
    ... class Spring(Layout):
    ...     stiffness: slice
    ...     damping: slice
    >>> layout = Spring.of(stiffness=2, damping=1)
    >>> layout.damping, layout.size
    (slice(2, 3, None), 3)
    """

    @classmethod
    def of(cls, **sizes: int) -> Self:
        """The layout with these numbers of entries, in the order of the fields.

        Raises
        ------
        TypeError
            A part has no size, or a size no part.
        """
        names = [field.name for field in fields(cls)]
        if set(sizes) != set(names):
            raise TypeError(f"{cls.__name__}: given {sorted(sizes)}, expected {names}")
        ends = np.cumsum([sizes[name] for name in names]).tolist()
        slices = [slice(end - sizes[name], end) for name, end in zip(names, ends, strict=True)]
        return cls(*slices)

    @property
    def parts(self) -> dict[str, slice]:
        """Name -> entries of each part."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @property
    def size(self) -> int:
        """Number of entries."""
        return max(part.stop for part in self.parts.values())

    def join(self, **parts: np.ndarray | float) -> np.ndarray:
        """The vector (size,) with these parts; others are zero."""
        out = np.zeros(self.size)
        for name, values in parts.items():
            out[self.parts[name]] = values
        return out

    def entries(self, part: slice) -> np.ndarray:
        """Indices of the entries of a part."""
        return np.arange(part.start, part.stop)
