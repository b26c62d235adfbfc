// clang-format off
// Constants of the robot @MODEL@. Written by flexgen.
#ifndef FLEXGEN_MODEL__ARM_HPP_
#define FLEXGEN_MODEL__ARM_HPP_

#include <array>

#include "flexgen_model/model.h"

namespace flexgen_space
{

// Arm coordinates that motors drive, in the order of the gears.
inline constexpr std::array<int, MODEL_NG> ACTUATED = {@ACTUATED@};

// Names of the motors, in the order of q_m.
inline constexpr std::array<const char *, MODEL_NM> MOTORS = {@MOTORS@};

// Torques on the arm at rest at home, from Lagrange's equations [N m, N].
inline constexpr std::array<double, MODEL_NA> HOME_TORQUES = {@HOME_TORQUES@};
#if MODEL_FORCE

// Components of the output among those of a force and a torque on the tool.
inline constexpr std::array<int, MODEL_NY> WRENCH_ROWS = {@WRENCH_ROWS@};
#endif /* MODEL_FORCE */
@STREAM@
} // namespace flexgen_space

#endif // FLEXGEN_MODEL__ARM_HPP_
