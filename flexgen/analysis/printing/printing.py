"""Closed-form equations on paper: a sheet of named expressions as plain text or as a LaTeX
document.

Names and descriptions come from model files: they are data. In LaTeX every character of them is
escaped.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass

import sympy as sp
from sympy.printing.latex import LatexPrinter
from sympy.printing.str import StrPrinter

_LATEX_CHARACTERS = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "$": r"\$",
    "&": r"\&",
    "#": r"\#",
    "%": r"\%",
    "_": r"\_",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': r"\textquotedbl{}",
    "`": r"\textasciigrave{}",
}
_PLAIN = re.compile(r"[A-Za-z0-9]+\Z")
_NUMBERED = re.compile(r"([a-z])([0-9])\Z")
_LINE = 110  # characters of LaTeX source after which an equation may be broken


@dataclass(frozen=True)
class Name:
    """A symbol's name: ``head`` (a letter, or a Greek one spelled out) and subscripts; ``plain``
    overrides the text.
    """

    head: str
    subscripts: tuple[str, ...] = ()
    plain: str = ""

    def text(self) -> str:
        """``m_link1``; the parts of ``q1`` are joined, as in the model file, where the only
        subscript is a number.
        """
        if self.plain:
            return one_line(self.plain)
        joint = (
            ""
            if len(self.head) == 1 and len(self.subscripts) == 1 and self.subscripts[0].isdigit()
            else "_"
        )
        return one_line(joint.join((self.head, *self.subscripts)))

    def latex(self) -> str:
        """``m_{\\mathrm{link1}}``, escaped."""
        head = self.head if len(self.head) == 1 else "\\" + self.head
        if not self.subscripts:
            return head
        return f"{head}_{{{','.join(_latex_subscript(part) for part in self.subscripts)}}}"


def _latex_subscript(part: str) -> str:
    """A part of a subscript in LaTeX: digits as they are, words upright, others escaped."""
    if part.isdigit():
        return part
    return (
        f"\\mathrm{{{part}}}"
        if _PLAIN.match(part) and part.isascii()
        else f"\\text{{{escape_latex(part)}}}"
    )


def escape_latex(text: str) -> str:
    """``text`` as LaTeX source that prints it: no character of it is taken as a command.

    White space and control characters become single spaces; letters outside Latin script become
    question marks.
    """
    out = []
    for character in " ".join(one_line(text).split()):
        if character in _LATEX_CHARACTERS:
            out.append(_LATEX_CHARACTERS[character])
        elif character.isascii():
            out.append(character)
        elif unicodedata.category(character) == "Pd":
            out.append("--")
        else:
            out.append(character if character.isalpha() and ord(character) < 0x180 else "?")
    return "".join(out)


def one_line(text: str) -> str:
    """``text`` without control characters and line breaks."""
    return "".join(" " if unicodedata.category(c)[0] in "CZ" else c for c in text)


@dataclass(frozen=True)
class Entry:
    """A line of the symbol table."""

    symbol: sp.Symbol
    name: Name
    unit: str
    meaning: str
    value: float | None = None


@dataclass(frozen=True)
class Row:
    """One named expression: its left-hand side, ``head[i, j]`` or ``head_subscript``, and its
    value.
    """

    head: str
    index: tuple[int, ...]
    value: sp.Expr
    name: Name | None = None

    def text(self) -> str:
        """Left-hand side in plain text."""
        return (
            self.name.text()
            if self.name
            else f"{self.head}[{','.join(str(i) for i in self.index)}]"
        )

    def latex(self) -> str:
        """Left-hand side in LaTeX."""
        return (
            self.name.latex()
            if self.name
            else f"{self.head}_{{{''.join(str(i) for i in self.index)}}}"
        )


@dataclass(frozen=True)
class Section:
    """A titled list of expressions; ``statement`` and ``statement_latex`` say how they belong
    together.
    """

    title: str
    rows: tuple[Row, ...]
    statement: str = ""
    statement_latex: str = ""


@dataclass(frozen=True)
class Sheet:
    """All that is printed about one model. ``coordinates``: the symbols that may be abbreviated
    inside sine, cosine.
    """

    title: str
    description: str
    source: str
    symbols: tuple[Entry, ...]
    sections: tuple[Section, ...]
    coordinates: tuple[sp.Symbol, ...]


class _Text(StrPrinter):
    """Plain text with abbreviations such as ``s12``."""

    def __init__(self, short: dict[sp.Expr, str]) -> None:
        super().__init__({"full_prec": False})
        self.short = short

    def _print_sin(self, expr: sp.Expr) -> str:
        return self.short.get(expr) or f"{expr.func.__name__}({self._print(expr.args[0])})"

    _print_cos = _print_sin

    def _print_Symbol(self, expr: sp.Symbol) -> str:
        return one_line(expr.name)

    def _print_Piecewise(self, expr: sp.Piecewise) -> str:
        """A case distinction on one line: ``{ value if condition; value otherwise }``."""
        parts = [
            f"{self._print(value)} otherwise"
            if condition == sp.true
            else f"{self._print(value)} if {_condition(self, condition)}"
            for value, condition in expr.args
        ]
        return "{ " + "; ".join(parts) + " }"


def _condition(printer: StrPrinter, condition: sp.Rel) -> str:
    if condition.rhs.has(sp.Abs):
        condition = condition.reversed
    return f"{printer._print(condition.lhs)} {condition.rel_op} {printer._print(condition.rhs)}"


class _Latex(LatexPrinter):
    """LaTeX with abbreviations such as s_12; symbols only by the names given."""

    def __init__(self, short: dict[sp.Expr, str], names: dict[sp.Symbol, str]) -> None:
        super().__init__({"symbol_names": names, "mul_symbol": r"\,", "full_prec": False})
        self.short = short
        self.names = names

    def _print_Symbol(self, expr: sp.Symbol, style: str = "plain") -> str:
        return self.names[expr]

    def _print_sin(self, expr: sp.Expr, exp: str | None = None) -> str:
        plain = self.short.get(expr)
        if plain is None:
            power = "" if exp is None else f"^{{{exp}}}"
            return f"\\{expr.func.__name__}{power}\\left({self._print(expr.args[0])}\\right)"
        return plain if exp is None else f"{plain}^{{{exp}}}"

    _print_cos = _print_sin


def _abbreviate(sheet: Sheet) -> dict[sp.Expr, tuple[str, str]]:
    """Abbreviations of sines and cosines of sums of numbered coordinates, ``s12``, in text and
    LaTeX, in order.
    """
    numbers = {}
    for symbol in sheet.coordinates:
        match = _NUMBERED.match(symbol.name)
        if match is None or match[1] != "q":
            return {}
        numbers[symbol] = match[2]
    used: set[sp.Expr] = set()
    for section in sheet.sections:
        for row in section.rows:
            used |= row.value.atoms(sp.sin, sp.cos)
    short = {}
    for f in used:
        terms = f.args[0].args if f.args[0].is_Add else (f.args[0],)
        if all(term in numbers for term in terms):
            digits = "".join(sorted(numbers[term] for term in terms))
            letter = "s" if isinstance(f, sp.sin) else "c"
            short[f] = (letter + digits, rf"\mathrm{{{letter}}}_{{{digits}}}")
    return dict(
        sorted(short.items(), key=lambda item: (len(item[1][0]), item[1][0][1:], item[1][0][0]))
    )


def _sum_arguments(f: sp.Expr, coordinates: Sequence[sp.Symbol]) -> list[sp.Symbol]:
    return [symbol for symbol in coordinates if f.args[0].has(symbol)]


def _value(value: float) -> str:
    return f"{value:.12g}"


def text(sheet: Sheet) -> str:
    """The sheet as plain text, one entry per line."""
    short = _abbreviate(sheet)
    printer = _Text({f: names[0] for f, names in short.items()})
    lines = [f"{one_line(sheet.title)}: {one_line(sheet.description)}".rstrip(": "), ""]
    if sheet.source:
        lines += [f"source: {one_line(sheet.source)}", ""]
    table = [
        (
            e.name.text(),
            "" if e.value is None else f"= {_value(e.value)}",
            f"[{e.unit}]",
            one_line(e.meaning),
        )
        for e in sheet.symbols
    ]
    widths = [max((len(line[k]) for line in table), default=0) for k in range(3)]
    lines += ["Symbols", ""]
    lines += [
        "  "
        + "  ".join([*(part.ljust(w) for part, w in zip(line, widths, strict=False)), line[3]])
        for line in table
    ]
    if short:
        lines += ["", "Abbreviations", ""]
        for f, names in short.items():
            angle = " + ".join(symbol.name for symbol in _sum_arguments(f, sheet.coordinates))
            lines.append(
                f"  {names[0].ljust(max(len(n[0]) for n in short.values()))} = "
                f"{f.func.__name__}({angle})"
            )
    for section in sheet.sections:
        lines += ["", section.title + (f":  {section.statement}" if section.statement else "")]
        lines += [""] if section.rows else []
        width = max((len(row.text()) for row in section.rows), default=0)
        lines += [
            f"  {row.text().ljust(width)} = {printer.doprint(row.value)}" for row in section.rows
        ]
    return "\n".join(line.rstrip() for line in lines) + "\n"


def latex(sheet: Sheet) -> str:
    """The sheet as a complete LaTeX document (article, amsmath)."""
    short = _abbreviate(sheet)
    names = {entry.symbol: entry.name.latex() for entry in sheet.symbols}
    printer = _Latex({f: both[1] for f, both in short.items()}, names)
    lines = [
        r"\documentclass[a4paper,10pt]{article}",
        r"\usepackage[T1]{fontenc}",
        r"\usepackage[utf8]{inputenc}",
        r"\usepackage{amsmath}",
        r"\usepackage{longtable}",
        r"\usepackage[landscape,margin=15mm]{geometry}",
        r"\allowdisplaybreaks",
        r"\setlength{\parindent}{0pt}",
        r"\sloppy",
        r"\begin{document}",
        rf"\section*{{{escape_latex(sheet.title)}}}",
        escape_latex(sheet.description),
        "",
    ]
    if sheet.source:
        lines += [r"\textit{Source:} " + escape_latex(sheet.source), ""]
    lines += [
        r"\subsection*{Symbols}",
        r"\begin{longtable}{@{}llll@{}}",
        r"symbol & value & unit & meaning \\ \hline",
    ]
    for entry in sheet.symbols:
        value = (
            ""
            if entry.value is None
            else f"${sp.latex(sp.Float(_value(entry.value)))}$"
            if "e" in _value(entry.value)
            else _value(entry.value)
        )
        lines.append(
            rf"${entry.name.latex()}$ & {value} & {_latex_unit(entry.unit)} & "
            rf"{escape_latex(entry.meaning)} \\"
        )
    lines.append(r"\end{longtable}")
    if short:
        sums = {
            f: " + ".join(names[symbol] for symbol in _sum_arguments(f, sheet.coordinates))
            for f in short
        }
        lines.append("Abbreviations:")
        lines += _align(
            [rf"{both[1]} &= \{f.func.__name__}({sums[f]})" for f, both in short.items()]
        )
    for section in sheet.sections:
        lines += ["", rf"\subsection*{{{escape_latex(section.title)}}}"]
        if section.statement_latex:
            lines.append(rf"\[ {section.statement_latex} \]")
        if section.rows:
            lines += _align(
                [rf"{row.latex()} &= {_break_lines(row.value, printer)}" for row in section.rows]
            )
    return "\n".join([*lines, r"\end{document}"]) + "\n"


def _align(rows: list[str]) -> list[str]:
    return [r"\begin{align*}", *(row + r" \\" for row in rows[:-1]), rows[-1], r"\end{align*}"]


def _latex_unit(unit: str) -> str:
    return re.sub(r"\^(\d)", r"$^\1$", unit) if unit else ""


def _pieces(expr: sp.Expr, printer: LatexPrinter) -> list[str]:
    """LaTeX of a sum in pieces between which a line may end: its terms, and those of a long
    bracket within.
    """
    out: list[str] = []
    for k, term in enumerate(printer._as_ordered_terms(expr) if expr.is_Add else [expr]):
        brackets = [part for part in term.args if part.is_Add] if term.is_Mul else []
        source = printer.doprint(term)
        sign = "" if source.startswith("-") or k == 0 else "+ "
        if len(source) > _LINE and len(brackets) == 1:
            outside = printer.doprint(
                sp.Mul(*[part for part in term.args if part is not brackets[0]])
            )
            inner = _pieces(brackets[0], printer)
            inner[0] = rf"{sign}{outside} \bigl( {inner[0]}"
            inner[-1] = rf"{inner[-1]} \bigr)"
            out += inner
        else:
            out.append(sign + source)
    return out


def _break_lines(expr: sp.Expr, printer: LatexPrinter) -> str:
    """LaTeX of an expression, broken into lines of an aligned display."""
    if expr.is_Piecewise:
        return str(printer.doprint(expr))
    lines = []
    line = ""
    for piece in _pieces(expr, printer):
        if line and len(line) + len(piece) > 2 * _LINE:
            lines.append(line)
            line = ""
        line = f"{line} {piece}".strip()
    return " \\\\\n  &\\quad {} ".join([*lines, line])
