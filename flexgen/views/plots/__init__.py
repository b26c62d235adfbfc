"""Plots of robots, solutions and analyses."""

import os

from flexgen.base.errors import ArgumentError

try:
    import matplotlib as matplotlib
except ValueError as error:  # a backend that does not exist; flexgen uses none
    raise ArgumentError(
        f"MPLBACKEND: given {os.environ.get('MPLBACKEND')!r}, which matplotlib refuses; unset "
        "it (MPLBACKEND=)"
    ) from error
