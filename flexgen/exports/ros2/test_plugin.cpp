// The plugin is found, and its torques at home are those of Lagrange's equations.
// Written by flexgen.
#include <cmath>
#include <memory>
#include <string>

#include <gtest/gtest.h>
#include <inverse_dynamics_interface/inverse_dynamics_interface.hpp>
#include <pluginlib/class_loader.hpp>

#include "flexgen_model/arm.hpp"
#include "flexgen_model/model.h"

TEST(Plugin, IsFoundAndHoldsTheArmAtHome)
{
    pluginlib::ClassLoader<inverse_dynamics_interface::InverseDynamicsInterface> loader(
        "inverse_dynamics_interface", "inverse_dynamics_interface::InverseDynamicsInterface");
    const auto plugin = loader.createUniqueInstance("flexgen_model/InverseDynamics");
    plugin->initialize(nullptr, "", "");
    const Eigen::VectorXd q = Eigen::Map<const Eigen::VectorXd>(model_home_q_a, MODEL_NA);
    const Eigen::VectorXd zero = Eigen::VectorXd::Zero(MODEL_NA);
    const Eigen::VectorXd tau = plugin->getTorques(q, zero, zero);
    for (int i = 0; i < MODEL_NA; ++i) {
        const double expected =
            flexgen_space::HOME_TORQUES[static_cast<std::size_t>(i)]; // from Lagrange's equations
        EXPECT_NEAR(tau[i], expected, 1e-9 * (1.0 + std::abs(expected))) << i;
    }
}
