"""Pictures that are empty frames, for tests of what is around them: matplotlib takes most of the
time of a report.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, BinaryIO, TextIO

from flexgen.views.plots import canvas


def draw_nothing(replace: Callable[[Any, str, Any], None] = setattr) -> None:
    """Let all figures of flexgen be written as empty files; ``replace``: as `setattr`, such as
    that of monkeypatch.
    """

    def frame(_: object, stream: TextIO, **options: object) -> None:
        stream.write('<svg xmlns="http://www.w3.org/2000/svg" id="figure_1"/>\n')

    real = canvas.FigureCanvasAgg.print_png

    @functools.wraps(real)  # matplotlib looks at its arguments
    def picture(canvas: Any, stream: BinaryIO, **options: Any) -> None:
        if "metadata" not in options:  # of the caller, not of flexgen
            return real(canvas, stream, **options)
        stream.write(
            b"\x89PNG"
            + b"".join(f"{key}\0{text}".encode() for key, text in options["metadata"].items())
        )

    replace(canvas.FigureCanvasSVG, "print_svg", frame)
    replace(canvas.FigureCanvasAgg, "print_png", picture)
