"""The sampler of planned paths in the hand-written C: its functions, for
`flexgen.codegen.emission.c_functions`.
"""

from __future__ import annotations

from flexgen.codegen.emission.clib_types import CFunction, Field

_TABLE = (
    Field(
        "table",
        "const real *",
        ("table_size",),
        "mixed",
        "of flexgen plan --out, or Path.table() in Python",
    ),
    Field("table_size", "int64_t", (), "1", "its length"),
)

SAMPLER_FUNCTIONS = (
    CFunction(
        "path_start",
        "path_sampler.c",
        "Duration of a planned path, and the joints at its start.",
        "BAD_ARGUMENT: the table is not one of this model, or it is damaged.",
        (
            *_TABLE,
            Field("duration", "real *", ("1",), "s", "time from rest to rest"),
            Field(
                "q_start",
                "real *",
                ("n_a",),
                "mixed",
                "arm coordinates at the start, without deflections",
            ),
        ),
    ),
    CFunction(
        "path_work",
        "path_sampler.c",
        "Length of the workspace of path_sample, in reals.",
        "",
        (),
        returns="size",
    ),
    CFunction(
        "path_sample",
        "path_sampler.c",
        "Sample of a planned path of lines, arcs, joint moves and blended programs at any time.",
        "The laws and curves are those of flexgen in Python: in double precision the samples "
        "have the same bits, those of joint moves up to the rounding of the kinematics. Before "
        "time 0 and after the duration the output is at rest. A call has a bounded number of "
        "operations and keeps nothing, so several streams may read one table. BAD_ARGUMENT: the "
        "table is not one of this model, or it is damaged.",
        (
            *_TABLE,
            Field("t", "real", (), "s", "time since the start of the path"),
            Field(
                "y",
                "real *",
                ("n_t",),
                "mixed",
                "output; for a pose the position, then the rotation matrix by columns",
            ),
            Field(
                "dy",
                "real *",
                ("n_y",),
                "mixed",
                "its first time derivative; for a pose linear and angular velocity",
            ),
            Field("ddy", "real *", ("n_y",), "mixed", "its second time derivative"),
            Field("work", "real *", ("work_size",), "", "workspace"),
            Field("work_size", "int64_t", (), "1", "its length, at least path_work"),
        ),
    ),
)
