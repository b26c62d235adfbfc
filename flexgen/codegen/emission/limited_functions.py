"""Inverse dynamics within limits in the hand-written C: its functions, for
`flexgen.codegen.emission.c_functions`.
"""

from __future__ import annotations

from flexgen.codegen.emission.clib_types import CFunction, Field

_OPTIONS = Field("options", "const inversion_options *", (), "", "")
_LIMITS = Field("limits", "const inversion_limits *", (), "", "")

LIMITED_FUNCTIONS = (
    CFunction(
        "invert_limited_work",
        "invert_limited.c",
        "Length of the workspace of invert_limited, in reals; -1 where an option is out of range.",
        "It depends on the number of limits: some tens of megabytes for a robot with six axes.",
        (Field("n", "int", (), "1", "samples of the path"), _OPTIONS, _LIMITS),
        returns="size",
        double=True,
    ),
    CFunction(
        "invert_limited",
        "invert_limited.c",
        "Inverse dynamics along a whole path within limits of motors, gears, deflections, "
        "joints and tool.",
        "Where the path itself keeps the limits, it is inverted as by invert (OK). Else the "
        "path is modified as little as possible: quadratic programs find a smooth deviation, "
        "and the modified path is inverted again until the limits are kept within 1e-3 of their "
        "values (LIMITS_ACTIVE, with the largest deviation in the info). The deviation is zero "
        "at the first and the last sample. A path that can only be driven more slowly needs "
        "time: repeat the first and the last sample with zero derivatives. Choose n_pre and "
        "n_post so that the motion before and after the samples has decayed. LIMITS_INFEASIBLE: "
        "the limits cannot be kept within this time, or not at rest at an end. The limits hold "
        "for the torque itself: with a hold, tau_m is what to send, which may exceed them a "
        "little. The call inverts the path some hundred times.",
        (
            Field("samples", "const samples *", (), "", "samples of the output"),
            Field(
                "q_start",
                "const real *",
                ("n_a",),
                "mixed",
                "initial guess of the equilibrium at the first sample",
            ),
            _OPTIONS,
            _LIMITS,
            Field("motion", "motion *", (), "", "results; N = n_pre + n + n_post"),
            Field("info", "invert_limited_info *", (), "", "what the solver reports"),
            Field("work", "real *", ("work_size",), "", "workspace"),
            Field("work_size", "int64_t", (), "1", "its length, at least invert_limited_work"),
        ),
        double=True,
    ),
)
