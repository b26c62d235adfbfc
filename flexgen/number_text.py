"""Numbers in texts of files, headers and options, as other programs write them."""

from __future__ import annotations


def number_in(text: str) -> float:
    """The number in a text; ValueError where it has none.

    Python alone reads ``1_000`` and digits of other scripts, such as fullwidth ones: a file with
    these is one that something has damaged.

    Examples
    --------
    >>> from flexgen.number_text import number_in
    >>> number_in(" 1.5e3")
    1500.0
    """
    if not text.isascii() or "_" in text:
        raise ValueError(f"could not convert text to a number: {text[:40]!r}")
    return float(text)


def is_count(text: str) -> bool:
    """Whether a text consists of the digits 0 to 9 alone."""
    return text.isascii() and text.isdigit()
