#ifndef STUB_INVERSE_DYNAMICS_INTERFACE_HPP
#define STUB_INVERSE_DYNAMICS_INTERFACE_HPP
#include <eigen3/Eigen/Core>
#include <rclcpp/node_interfaces/node_parameters_interface.hpp>
#include <string>
#include <tuple>

namespace inverse_dynamics_interface
{
class InverseDynamicsInterface
{
public:
    virtual ~InverseDynamicsInterface() = default;
    virtual void initialize(
        rclcpp::node_interfaces::NodeParametersInterface::ConstSharedPtr parameters_interface,
        const std::string &param_namespace = "", const std::string &robot_description = "") = 0;
    virtual std::tuple<Eigen::MatrixXd, Eigen::VectorXd, Eigen::VectorXd> getDynamicParameters(
        const Eigen::VectorXd &joint_positions, const Eigen::VectorXd &joint_velocities) const
    {
        return {getInertiaMatrix(joint_positions),
            getCoriolisVector(joint_positions, joint_velocities),
            getGravityVector(joint_positions)};
    }
    virtual Eigen::MatrixXd getInertiaMatrix(const Eigen::VectorXd &joint_positions) const = 0;
    virtual Eigen::VectorXd getCoriolisVector(
        const Eigen::VectorXd &joint_positions, const Eigen::VectorXd &joint_velocities) const = 0;
    virtual Eigen::VectorXd getGravityVector(const Eigen::VectorXd &joint_positions) const = 0;
    virtual Eigen::VectorXd getFrictionVector(const Eigen::VectorXd &joint_velocities) const = 0;
    virtual Eigen::VectorXd getExternalTorques(const Eigen::VectorXd &joint_positions,
        const Eigen::Matrix<double, 6, 1> &external_wrench) const = 0;
    virtual Eigen::VectorXd getTorques(const Eigen::VectorXd &joint_positions,
        const Eigen::VectorXd &joint_velocities, const Eigen::VectorXd &joint_accelerations,
        const Eigen::Matrix<double, 6, 1> &external_wrench = Eigen::VectorXd::Zero(6)) const = 0;

  protected:
    InverseDynamicsInterface() = default;
};
} // namespace inverse_dynamics_interface
#endif
