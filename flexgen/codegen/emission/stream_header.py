"""The private header with the memory of a stream in C, from the rows of
`flexgen.codegen.emission.stream_layout`.
"""

from __future__ import annotations

import textwrap

from flexgen.codegen.emission.c_text import WIDTH, macro
from flexgen.codegen.emission.size_terms import Term
from flexgen.codegen.emission.spec import LibrarySpec
from flexgen.codegen.emission.stream_layout import (
    ARRAYS,
    CONSTANTS,
    LIMIT_ARRAYS,
    Row,
    StreamLayout,
)
from flexgen.runtime.streams.head import members_of

# Headers of the hand-written C whose constants the sizes have, and the part that each needs.
_INCLUDED = {
    "hysteresis": "HYSTERESIS",
    "lq_step": "",
    "lugre": "LUGRE",
    "motors": "",
    "path": "",
    "servo": "POSITION",
}


def stream_header(spec: LibrarySpec, layout: StreamLayout) -> str:
    """Text of ``<name>_stream_layout.h``.

    Parameters
    ----------
    spec : LibrarySpec
    layout : StreamLayout
        Of the library's streams.
    """
    name = spec.name
    guard = macro(spec, "STREAM_LAYOUT_H")
    parts = layout.parts
    included = "".join(
        f'#include "{name}_{file}.h"\n'
        for file, part in _INCLUDED.items()
        if not part or part in parts
    )
    constants = "".join(
        _line(f"    {row.name} = {_text(row)}", row.doc, ",") for row in layout.rows(CONSTANTS)
    )
    equal = textwrap.fill(
        " && ".join(f"(int){constant}=={value}" for constant, value in layout.given().items()),
        WIDTH - 6,
        subsequent_indent="    ",
        break_on_hyphens=False,
    ).replace("==", " == ")
    reach = " + REACH" if layout.reach else ""
    space = "lq_space" if spec.sizes["n_e"] else "problem_points"
    return f"""\
/*
 * {name}: the memory of a stream; private. Written by flexgen from one table; see {name}.h.
 */
#ifndef {guard}
#define {guard}

#include "{name}_inversion_common.h"
{included}
enum {{
{constants}}};

{_head(layout)}
/* Place an array of so many reals behind those before it. */
static inline ptrdiff_t next_place(ptrdiff_t *at, ptrdiff_t size)
{{
    const ptrdiff_t here = *at;
    *at += (ptrdiff_t)padded(size);
    return here;
}}

/* Positions of the arrays for the limits, from the first one on. */
typedef struct {{
{_members(layout.rows(LIMIT_ARRAYS))}    ptrdiff_t end;
}} limits_layout;

static inline limits_layout limits_laid_out(ptrdiff_t intervals)
{{
    limits_layout l;
    ptrdiff_t at = 0;
{_places(layout.rows(LIMIT_ARRAYS))}    l.end = at;
    return l;
}}

/* Positions of the arrays of a stream. */
typedef struct {{
    ptrdiff_t window; /* samples: before, of an update and its end, ahead */
    ptrdiff_t ahead;  /* samples after those of an update that held torques depend on */
    ptrdiff_t past;   /* past intervals that are kept */
{_members(layout.rows(ARRAYS))}    ptrdiff_t end;
}} layout;

static inline layout laid_out(
    ptrdiff_t intervals, ptrdiff_t samples_per_interval, int hold, real delay)
{{
    layout l;
    const ptrdiff_t ahead = {_ahead(layout)};
    const ptrdiff_t held = ahead > 0;
    const ptrdiff_t window = 2 * BACK + samples_per_interval + 1 + ahead{reach};
    const ptrdiff_t least = LAST - 1;
    const ptrdiff_t needed = (BACK + samples_per_interval - 1) / samples_per_interval + 1;
    const ptrdiff_t past = needed < least ? least : needed;
    ptrdiff_t at = HEAD;
    l.ahead = ahead;
    l.window = window;
    l.past = past;
{_places(layout.rows(ARRAYS))}    l.end = at;
    return l;
}}

/* The constants are those with which flexgen computed the memory that the public header states. */
enum {{
    constants_are_those_of_flexgen =
    {equal},
    spaces_are_those_of_flexgen =
    sizeof({space}) == STEP_SPACE * sizeof(real) &&
    sizeof(stream_head) <= HEAD * sizeof(real)
}};
typedef char memory_is_that_of_flexgen[constants_are_those_of_flexgen ? 1 : -1];
typedef char spaces_hold_what_they_must[spaces_are_those_of_flexgen ? 1 : -1];

#endif
"""


def _head(layout: StreamLayout) -> str:
    """The struct with the integers and flags of a stream, and the functions that find it."""
    members = "".join(
        _line(
            f"    {member.kind} {member.name}{f'[{member.count}]' * (member.count > 1)}",
            member.doc,
            ";",
        )
        for member in members_of(layout.parts)
    )
    return f"""\
/* The head of the memory of a stream: it may hold anything before the start. */
typedef struct {{
{members}}} MAY_ALIAS stream_head;

enum {{
    STEP_SPACE = {layout.step_space}, /* reals of the space of a step */
    FUNCTION_SPACE = {layout.function_work}, /* reals of the space of the functions */
    HEAD = {layout.head_size} /* reals before the arrays */
}};

static inline stream_head *head_of(real *memory)
{{
    return (stream_head *)(void *)memory;
}}

static inline const stream_head *head_in(const real *memory)
{{
    return (const stream_head *)(const void *)memory;
}}
"""


def _ahead(layout: StreamLayout) -> str:
    """The samples ahead in C, as `StreamLayout.ahead`."""
    after = " + FILTER_AHEAD" * any(layout.has.filters)
    bristles = " + MARGIN" * layout.has.bristles
    held = f"is_held(hold, delay) ? HOLD_AFTER - 1 + (int)delay{after} : 0"
    return f"({held}){bristles}" if bristles else held


def _members(rows: list[Row]) -> str:
    return "".join(_line(f"    ptrdiff_t {row.name}", row.doc, ";") for row in rows)


def _places(rows: list[Row]) -> str:
    return "".join(f"    l.{row.name} = next_place(&at, {_text(row)});\n" for row in rows)


def _text(row: Row) -> str:
    return row.size.c() if isinstance(row.size, Term) else str(row.size)


def _line(start: str, doc: str, end: str) -> str:
    """A member and its comment: behind it, or above it where the line would be long."""
    if not doc:
        return f"{start}{end}\n"
    line = f"{start}{end} /* {doc} */"
    return f"{line}\n" if len(line) <= WIDTH else f"    /* {doc} */\n{start}{end}\n"
