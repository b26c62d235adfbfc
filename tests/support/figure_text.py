"""A figure as lines of text: titles, labels, scales, limits, ticks, data and style of lines,
entries of legends.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.ticker import AutoLocator, FixedLocator


def number(value: float) -> str:
    """Six digits; rounding errors and the two zeros are the same."""
    return f"{0.0 if abs(value) < 1e-13 else float(value):.6g}"


def row(values: Any) -> str:
    """Some numbers; what is below a billionth of the largest is rounding."""
    x = np.ravel(np.ma.filled(np.ma.asarray(values, dtype=float), np.nan))
    tiny = 1e-9 * np.abs(x[np.isfinite(x)]).max(initial=0.0)
    return " ".join(number(0.0 if abs(value) < tiny else value) for value in x)


def data(values: Any) -> str:
    """Short rows completely, long ones by their count, ends, smallest, largest and two weighted
    sums.
    """
    x = np.asarray(values, dtype=float)
    if len(x) <= 8:
        return f"[{row(x)}]"
    good = np.isfinite(x)
    y = x[good]
    weights = np.arange(1.0, len(x) + 1.0)[good]
    sums = (y.sum(), y @ weights / len(x), np.diff(y) @ np.diff(y)) if len(y) else ()
    ends = (x[0], x[-1], y.min(), y.max()) if len(y) else ()
    return f"[{len(x)} {good.sum()}: {row((*ends, *sums))}]"


def style(line: Any) -> str:
    """Color, widths, dashes, marker, transparency and order of a line, and whether files have it
    as pixels.
    """
    marker = (
        f" {line.get_marker()} {line.get_markersize():g} {line.get_markerfacecolor()} "
        f"{line.get_markeredgecolor()}"
    )
    marked = (
        f"{marker} {line.get_markeredgewidth():g}"
        if line.get_marker() not in ("None", None, "")
        else ""
    )
    # also in a file of vectors, where there are many
    marked += " pixels" * bool(line.get_rasterized())
    # what was given, whatever `get_linestyle` shows
    dash = [number(x) for x in line._unscaled_dash_pattern[1] or ()]
    return (
        f"{to_hex(line.get_color())} lw {line.get_linewidth():g} ls {line.get_linestyle()} "
        f"{' '.join(dash)} a {line.get_alpha()} z {line.get_zorder():g}{marked}"
    )


def of_legend(legend: Legend | None) -> Iterator[str]:
    """Place, columns and entries."""
    if legend is not None:
        box = legend.get_bbox_to_anchor()
        inverse = (
            (legend.axes or legend.get_figure()).transAxes
            if legend.axes
            else legend.get_figure().transSubfigure
        )
        corner = inverse.inverted().transform((box.x0, box.y0))
        texts = " | ".join(text.get_text() for text in legend.get_texts())
        title = legend.get_title().get_text()
        place = f"{legend._loc} at {row(corner)} columns {legend._ncols}"
        place += (
            f" spacing {legend.columnspacing:g} {legend.handletextpad:g} scale "
            f"{legend.markerscale:g}"
        )
        yield f"  legend {place} {title} frame {legend.get_frame_on()}: {texts}"
        lines = [handle for handle in legend.legend_handles if isinstance(handle, Line2D)]
        if lines:
            yield f"    drawn as {' | '.join(map(style, lines))}"


def of_axes(ax: Axes) -> Iterator[str]:
    """All of one axis."""
    titles = " | ".join(
        f"{text.get_text()} {text.get_fontsize():g} {text.get_color()}" if text.get_text() else ""
        for text in (ax._left_title, ax.title, ax._right_title)
    )
    place = row(ax.get_position(original=True).bounds)
    yield f"axes visible {ax.get_visible()} aspect {ax.get_aspect()} at {place}: {titles}"
    for name, axis in (("x", ax.xaxis), ("y", ax.yaxis)):
        low, high = axis.get_view_interval()
        labels = axis.get_tick_params()
        grid = labels.get("grid_on", labels.get("gridOn"))
        size = labels.get("labelsize")
        # whose ticks depend on sizes of texts
        own = not isinstance(axis.get_major_locator(), AutoLocator)
        if isinstance(axis.get_major_locator(), FixedLocator):  # that of texts at their places
            size = " ".join(
                f"{text.get_fontsize():g} {text.get_rotation():g}"
                for text in axis.get_majorticklabels()[:1]
            )
        ticks = [
            t for t in axis.get_majorticklocs() if own and min(low, high) <= t <= max(low, high)
        ]
        texts = axis.get_major_formatter().format_ticks(ticks)
        shown = axis.get_tick_params().get("labelleft" if name == "y" else "labelbottom", True)
        linear = getattr(axis.get_transform(), "linthresh", None)  # of a symmetric logarithm
        scale = axis.get_scale() + (f" {number(linear)}" if linear is not None else "")
        yield (
            f"  {name} {scale} {row((low, high))} ticks {row(ticks)} {' '.join(texts)} minor "
            f"{type(axis.get_minor_formatter()).__name__} shown {shown} grid {grid} size {size} "
            f"inverted {axis.get_inverted()}: {axis.get_label_text()!r}"
        )
    for line in ax.lines:
        yield (
            f"  line {line.get_label()}: {style(line)} x {data(line.get_xdata())} y "
            f"{data(line.get_ydata())}"
        )
    for patch in ax.patches:
        box = (
            patch.get_path().vertices @ np.eye(2)
            if patch.get_transform() is None
            else patch.get_extents()
        )
        inverse = ax.transData.inverted().transform(box.get_points())
        color = row(patch.get_facecolor())
        yield (
            f"  patch {row(inverse)} {color} z {patch.get_zorder():g} lw {patch.get_linewidth():g}"
        )
    for group in ax.collections:
        points = np.concatenate([np.zeros((0, 2)), *(path.vertices for path in group.get_paths())])
        look = f"{row(group.get_facecolor())} lw {row(group.get_linewidth())}"
        yield f"  area {look} x {data(points[:, 0])} y {data(points[:, 1])}"
    for image in ax.images:
        yield (
            f"  image {image.cmap.name} {row(image.get_clim())} "
            f"{data(np.ravel(image.get_array()))}"
        )
    for text in ax.texts:
        place = getattr(text, "xyann", text.get_position())
        where = f"{row(getattr(text, 'xy', ()))} {row(place)} {text.get_ha()} {text.get_va()}"
        where = f"{text.get_fontsize():g} {text.get_color()} {where}"
        yield f"  text {text.get_text()!r} at {where}"
    yield from of_legend(ax.get_legend())


def of_part(part: Any) -> Iterator[str]:
    """A figure or a part of one, whose parts come after its own axes."""
    for ax in part.axes if not part.subfigs else part._localaxes:
        yield from of_axes(ax)
    for legend in part.legends:
        yield from of_legend(legend)
    for text in (part._supxlabel, part._supylabel):
        if text is not None:
            yield f"  {text.get_text()!r} {text.get_fontsize():g}"
    for k, inner in enumerate(part.subfigs):
        yield f"part {k}: {row(inner.bbox_relative.bounds)}"
        yield from of_part(inner)


def figure_text(figure: Figure) -> list[str]:
    """All lines; no pixel is drawn."""
    title = figure._suptitle
    engine = figure.get_layout_engine()
    pads = (
        ""
        if engine is None
        else " ".join(f"{name} {value}" for name, value in engine.get().items())
    )
    what = (
        ""
        if title is None
        else f"{title.get_text()} | {title.get_fontsize():.6g} at {row(title.get_position())}"
    )
    return [f"figure {row(figure.get_size_inches())} {pads}: {what}", *of_part(figure)]
