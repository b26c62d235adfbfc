"""Positions to send in the hand-written C: its functions, for
`flexgen.codegen.emission.c_functions`.
"""

from __future__ import annotations

from flexgen.codegen.emission.clib_types import CFunction, Field
from flexgen.codegen.emission.interface import POSITION

_INTERFACE = Field("robot", "const robot_interface *", (), "", "")
_COUNT = Field("n", "int", (), "1", "samples of the servo, at least 2")

POSITION_FUNCTIONS = (
    CFunction(
        "servo_defaults",
        "",
        "The position servo of the model file, for the member servo of options.",
        "With it invert, bvp, invert_limited and streams give the positions to send to the "
        "robot, in addition to the torques: the reference with which the servo sends tau_m "
        "along q_m. They need the hold HOLD_ZOH, and samples and delay of the servo "
        "(BAD_ARGUMENT), whole paths also q_m and tau_m (NULL_ARGUMENT). The servo rests at the "
        "first sample, and its integral part holds the torque there; so stream_start_moving "
        "takes no servo (BAD_ARGUMENT). Where positions are sent less often than the servo "
        "samples them, these are not the best ones.",
        (),
        returns="servo",
        part=POSITION,
    ),
    CFunction(
        "position_samples_work",
        "position_samples.c",
        "Length of the workspace of position_samples, in reals; -1 where an argument is out of "
        "range.",
        "",
        (_COUNT, _INTERFACE),
        returns="size",
        part=POSITION,
    ),
    CFunction(
        "position_samples",
        "position_samples.c",
        "Positions for an interface that takes one every few samples of the servo.",
        "Those whose interpolation by the robot is closest to the reference that the servo "
        "needs, by least squares over all samples: m = (n - 1) / samples_per_position + 1 "
        "positions, the first acts at the first sample. The samples must begin and end at rest: "
        "choose n_post such that the integral part of the servo has filled. Of a stream take "
        "the samples around the position to send: with 8 positions on either side the one in "
        "the middle is that of all samples up to 1e-9 rad where the robot follows lines, 1e-7 "
        "rad with polynomials.",
        (
            Field(
                "command_g",
                "const real *",
                ("n", "n_g"),
                "mixed",
                "of invert or a stream, sample after sample",
            ),
            _COUNT,
            _INTERFACE,
            Field(
                "positions", "real *", ("m", "n_g"), "mixed", "results, position after position"
            ),
            Field("work", "real *", ("work_size",), "", "workspace"),
            Field("work_size", "int64_t", (), "1", "its length, at least position_samples_work"),
        ),
        part=POSITION,
    ),
)
