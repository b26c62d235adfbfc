"""The base of results of estimations: fitted numbers with their accuracy, a status, and what the
data leave open.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from flexgen.base.checks.type_checks import checked_methods
from flexgen.base.results import Result
from flexgen.base.rows import Row
from flexgen.identification.estimator.status import FitStatus


@dataclass(frozen=True)
class FittedNumber:
    """A number of a fit.

    ``value`` [``unit``], SI; ``sd``: its standard deviation, in the same unit, or relative where
    ``is_relative``; None where the status of the fit has none. ``is_determined``: by the data,
    not by a prior or a bound.

    Examples
    --------
    >>> from flexgen.identification.estimator.fit_result import FittedNumber
    >>> FittedNumber("q1.stiffness", 7.5e6, "N m/rad", 0.02, is_relative=True).deviation
    150000.0
    """

    name: str
    value: float
    unit: str
    sd: float | None
    is_relative: bool = False
    is_determined: bool = True

    @property
    def deviation(self) -> float | None:
        """Standard deviation in the unit of the number; None where there is none."""
        if self.sd is None or not self.is_relative:
            return self.sd
        return abs(self.value) * self.sd

    def row(self, label: str = "", digits: int = 4) -> Row:
        """The row of the number, in the unit of the model file; the label: its name."""
        if not self.is_determined:
            return Row(label or self.name, self.value, text="not determined")
        sd = "" if self.sd is None else f" +- {self.sd:.2g}"
        if self.sd is not None and self.is_relative:
            sd = f" +- {100 * self.sd:.2g} %"
        text = f"{self.value:.{digits}g}{sd}"
        return Row(label or self.name, self.value, self.unit, sd=self.deviation, text=text)


@checked_methods
class FitResult(Result):
    """Base of results of estimations.

    A result states `fitted` and `status`; the others follow from these where it has none of its
    own.
    """

    @cached_property
    def fitted(self) -> tuple[FittedNumber, ...]:
        """The numbers with their standard deviations."""
        return ()

    @cached_property
    def status(self) -> FitStatus:
        """Status of the fit: how far its numbers can be used."""
        return FitStatus.NOT_CHECKED

    @cached_property
    def weak(self) -> tuple[str, ...]:
        """Sentences on numbers, or directions of them, that the data do not determine."""
        return tuple(
            f"{number.name} is not determined"
            for number in self.fitted
            if not number.is_determined
        )

    @cached_property
    def causes(self) -> tuple[Any, ...]:
        """Faults of the model or the record that are likely, the first most; each is a sentence
        as a text. Empty where nothing is named.
        """
        return ()

    @property
    def values(self) -> dict[str, float]:
        """Name -> value, SI units."""
        return {number.name: number.value for number in self.fitted}

    @property
    def sd(self) -> Mapping[str, float | None]:
        """Name -> standard deviation, see `FittedNumber`; None where the status has none."""
        return {number.name: number.sd for number in self.fitted}

    def write(self, path: str | Path) -> Path:
        """Write the file that uses the numbers; of a fit that has no such file, what `save`
        writes.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        ArgumentError
            The name ends otherwise, or the file cannot be written.
        """
        return super().save(path)

    def save(self, path: str | Path) -> Path:
        """Write ``.toml``: see `write`; ``.json``: what `to_dict` returns; ``.npz``: the arrays.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        ArgumentError
            The name ends otherwise, or the file cannot be written.
        """
        return self.write(path) if Path(path).suffix == ".toml" else super().save(path)
