"""One number of a model compared with the usual range of robots, and the list of all of them."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields

from flexgen.base.checks.type_checks import checked_result
from flexgen.base.registry import find_function
from flexgen.base.results import Result
from flexgen.base.rows import Column, Data, Part, Prose, Row, Table

OK = "ok"
UNUSUAL = "unusual"
ERROR = "error"
MARKS = (OK, UNUSUAL, ERROR)


@dataclass(frozen=True)
class Usual:
    """Usual range from ``low`` to ``high``; a number below ``least`` or above ``most`` is an
    error. All in one unit.
    """

    low: float
    high: float
    least: float = 0.0
    most: float = math.inf

    def mark(self, value: float) -> str:
        """``"ok"``, ``"unusual"`` or ``"error"``."""
        if not self.least <= value <= self.most:
            return ERROR
        return OK if self.low <= value <= self.high else UNUSUAL

    def distance(self, value: float) -> float:
        """By how many powers of ten the value is outside; 0 inside, at most 99."""
        if not math.isfinite(value) or value <= 0.0:
            return 0.0 if self.low <= 0.0 and math.isfinite(value) else 99.0
        above = math.log10(value / self.high) if value > self.high else 0.0
        return above if value >= self.low else math.log10(self.low / value)

    def __str__(self) -> str:
        if self.low == 0.0:
            return f"at most {self.high:.4g}"
        return (
            f"at least {self.low:.4g}"
            if math.isinf(self.high)
            else f"{self.low:.4g} to {self.high:.4g}"
        )


@checked_result
@dataclass(frozen=True)
class Finding:
    """One number that was checked.

    ``mark``: ``"ok"``, ``"unusual"`` (look at it) or ``"error"`` (no robot has it); ``key``: its
    place in the model file; ``quantity``, ``value`` and ``usual`` as text with units; ``advice``:
    what to look at, empty where the mark is ``"ok"``; ``distance``: powers of ten between the
    value and the usual range.

    Examples
    --------
    >>> robot = flexgen.read("elbow", overrides={"motor.m1.inertia": 1.0})
    >>> finding = next(one for one in flexgen.check(robot).findings if one.mark != "ok")
    >>> finding.mark, finding.key, finding.value
    ('unusual', 'motor.m1.inertia', '1 kg m^2')
    """

    mark: str
    key: str
    quantity: str
    value: str
    usual: str
    advice: str = ""
    distance: float = 0.0

    def __str__(self) -> str:
        return f"{self.key}: {self.quantity} {self.value}, usual {self.usual}; {self.advice}"


def make_finding(
    key: str, quantity: str, value: float, unit: str, usual: Usual, advice: str
) -> Finding:
    """A number as a `Finding`."""
    mark = usual.mark(value)
    unit = f" {unit}" if unit else ""
    text = f"{value:.4g}{unit}"
    expected = f"{usual}{unit}"
    return Finding(
        mark, key, quantity, text, expected, advice if mark != OK else "", usual.distance(value)
    )


@checked_result
@dataclass(frozen=True, repr=False)
class Check(Result):
    """The result of `check`: ``model``, its name and variant, and ``findings``, all numbers that
    were checked.

    Examples
    --------
    >>> checked = flexgen.check("elbow")
    >>> checked.errors, checked.warnings
    ((), ())
    """

    model: str
    findings: tuple[Finding, ...]

    @property
    def errors(self) -> tuple[Finding, ...]:
        """The findings with the mark ``"error"``, the farthest from the usual range first."""
        return self._select(ERROR)

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """The findings with the mark ``"unusual"``, the farthest from the usual range first."""
        return self._select(UNUSUAL)

    @property
    def worst(self) -> Finding | None:
        """The first error in the file that has the key of the largest error; None without
        errors.
        """
        return next(
            (f for f in self.findings if f.mark == ERROR and f.key == self.errors[0].key), None
        )

    @property
    def problem(self) -> str:
        """The number of errors and the worst one; empty without errors."""
        words = "1 error:" if len(self.errors) == 1 else f"{len(self.errors)} errors, the worst:"
        return f"{words} {self.worst}" if self.errors else ""

    def _select(self, mark: str) -> tuple[Finding, ...]:
        found = [finding for finding in self.findings if finding.mark == mark]
        return tuple(sorted(found, key=lambda finding: -finding.distance))

    def summary(self) -> str:
        """One sentence: how many numbers were checked, and how many are unusual or wrong."""
        errors = "1 error" if len(self.errors) == 1 else f"{len(self.errors)} errors"
        counts = f"{errors}, {len(self.warnings)} unusual"
        return f"{self.model}: {len(self.findings)} numbers checked, {counts}"

    def all_findings(self) -> str:
        """A table of all numbers that were checked, as text."""
        return str(find_function("Check.all_findings")(self))

    def __repr__(self) -> str:
        worst = [*self.errors, *self.warnings]
        more = [f"... and {len(worst) - 10} more"] if len(worst) > 10 else []
        return "\n".join(
            [f"<Check {self.summary()}>", *(f"  {f.mark}: {f}" for f in worst[:10]), *more]
        )

    def content(self) -> tuple[Part, ...]:
        """The counts, and a table of all findings."""
        names = [field.name for field in fields(Finding)]
        columns = tuple(Column(name, "", name) for name in names)
        cells = tuple(tuple(asdict(finding).values()) for finding in self.findings)
        return (
            Data("model", self.model),
            Prose(self.summary(), is_title=True),
            Row("errors", len(self.errors), "", "errors"),
            Row("unusual", len(self.warnings), "", "unusual"),
            Table(columns, cells, "Numbers", "findings"),
        )
