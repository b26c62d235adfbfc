// Written by flexgen; see the header.
#include "flexgen_model/inverse_dynamics.hpp"

#include <stdexcept>
#include <string>
#include <type_traits>

#include <inverse_dynamics_interface/exceptions.hpp>
#include <pluginlib/class_list_macros.hpp>

#include "flexgen_model/arm.hpp"
#include "flexgen_model/model.h"

namespace flexgen_space
{
namespace
{

// Call a function of the library, with a workspace where it takes one.
template <typename Function, typename... Arrays> void call(Function function, Arrays... arrays)
{
    model_status status = MODEL_OK;
    if constexpr (std::is_invocable_v<Function, Arrays..., double *>) {
        double work[MODEL_WORK];
        status = function(arrays..., work);
    } else {
        status = function(arrays...);
    }
    if (status != MODEL_OK) {
        throw std::runtime_error(std::string("inverse dynamics: ") + model_status_text(status));
    }
}

void check(bool initialized, const char *what, const Eigen::VectorXd &x)
{
    if (!initialized) {
        throw inverse_dynamics_interface::UninitializedException();
    }
    if (x.size() != MODEL_NA) {
        throw std::invalid_argument(std::string(what) + ": given " + std::to_string(x.size()) +
                                    " numbers, expected " + std::to_string(MODEL_NA) +
                                    ", one for each arm coordinate");
    }
}

} // namespace

void InverseDynamics::initialize(rclcpp::node_interfaces::NodeParametersInterface::ConstSharedPtr,
    const std::string &, const std::string &)
{
    initialized_ = true;
}

Eigen::MatrixXd InverseDynamics::getInertiaMatrix(const Eigen::VectorXd &joint_positions) const
{
    check(initialized_, "joint_positions", joint_positions);
    Eigen::MatrixXd M(MODEL_NA, MODEL_NA); // Eigen stores by columns, as the library does
    call(model_mass_matrix, joint_positions.data(), M.data());
    return M;
}

Eigen::VectorXd InverseDynamics::getCoriolisVector(
    const Eigen::VectorXd &joint_positions, const Eigen::VectorXd &joint_velocities) const
{
    check(initialized_, "joint_positions", joint_positions);
    check(initialized_, "joint_velocities", joint_velocities);
    Eigen::VectorXd h(MODEL_NA), g(MODEL_NA);
    call(model_bias, joint_positions.data(), joint_velocities.data(), h.data());
    call(model_gravity, joint_positions.data(), g.data());
    return h - g;
}

Eigen::VectorXd InverseDynamics::getGravityVector(const Eigen::VectorXd &joint_positions) const
{
    check(initialized_, "joint_positions", joint_positions);
    Eigen::VectorXd g(MODEL_NA);
    call(model_gravity, joint_positions.data(), g.data());
    return g;
}

Eigen::VectorXd InverseDynamics::getFrictionVector(const Eigen::VectorXd &joint_velocities) const
{
    check(initialized_, "joint_velocities", joint_velocities);@REFUSED_FRICTION@
#if MODEL_LOAD
#else  /* MODEL_LOAD */
    double v_m[MODEL_NM], f_m[MODEL_NM];
    for (int j = 0; j < MODEL_NM; ++j) {
        v_m[j] = 0.0;
        for (int i = 0; i < MODEL_NG; ++i) {
            v_m[j] += model_gear_ratio[j][i] * joint_velocities[ACTUATED[i]];
        }
    }
    call(model_motor_friction, static_cast<const double *>(v_m), static_cast<double *>(f_m));
    Eigen::VectorXd f = Eigen::VectorXd::Zero(MODEL_NA);
    for (int i = 0; i < MODEL_NG; ++i) {
        for (int j = 0; j < MODEL_NM; ++j) {
            f[ACTUATED[i]] += model_gear_ratio[j][i] * f_m[j];
        }
    }
    return f;
#endif /* MODEL_LOAD */
}

Eigen::VectorXd InverseDynamics::getExternalTorques(const Eigen::VectorXd &joint_positions,
    const Eigen::Matrix<double, 6, 1> &external_wrench) const
{
    check(initialized_, "joint_positions", joint_positions);
    Eigen::Matrix<double, 6, Eigen::Dynamic> J(6, MODEL_NA);
    call(model_jacobian, joint_positions.data(), J.data());
    return J.transpose() * external_wrench;
}

Eigen::VectorXd InverseDynamics::getTorques(const Eigen::VectorXd &joint_positions,
    const Eigen::VectorXd &joint_velocities, const Eigen::VectorXd &joint_accelerations,
    const Eigen::Matrix<double, 6, 1> &external_wrench) const
{
    check(initialized_, "joint_positions", joint_positions);
    check(initialized_, "joint_velocities", joint_velocities);
    check(initialized_, "joint_accelerations", joint_accelerations);
    Eigen::VectorXd tau(MODEL_NA);
    call(model_inverse_dynamics, joint_positions.data(), joint_velocities.data(),
        joint_accelerations.data(), tau.data());
    if (!external_wrench.isZero(0.0)) {
        tau += getExternalTorques(joint_positions, external_wrench);
    }
    return tau;
}

} // namespace flexgen_space

PLUGINLIB_EXPORT_CLASS(
    flexgen_space::InverseDynamics, inverse_dynamics_interface::InverseDynamicsInterface)
