// Inverse dynamics of the arm as a plugin of inverse_dynamics_interface. Written by flexgen.
#ifndef FLEXGEN_MODEL__INVERSE_DYNAMICS_HPP_
#define FLEXGEN_MODEL__INVERSE_DYNAMICS_HPP_

#include <string>

#include <eigen3/Eigen/Core>
#include <inverse_dynamics_interface/inverse_dynamics_interface.hpp>

namespace flexgen_space
{

// All arm coordinates in chain order, those without a motor too; arm side, SI units. The URDF is
// not read: the dynamics are those of the file that flexgen was given.
//
// getTorques: M(q) a + c(q, v) + g(q) + J(q)' wrench, without friction; with a zero wrench the
// bits of the library. getFrictionVector: friction of the motors, seen from the arm through rigid
// gears. The wrench acts at the tool: force [N], then torque [N m], world axes.
//
// Errors: std::invalid_argument for a wrong size, std::runtime_error for numbers that are not
// finite, UninitializedException before initialize.
class InverseDynamics : public inverse_dynamics_interface::InverseDynamicsInterface
{
  public:
    void initialize(
        rclcpp::node_interfaces::NodeParametersInterface::ConstSharedPtr parameters_interface,
        const std::string &param_namespace, const std::string &robot_description) override;
    Eigen::MatrixXd getInertiaMatrix(const Eigen::VectorXd &joint_positions) const override;
    Eigen::VectorXd getCoriolisVector(const Eigen::VectorXd &joint_positions,
        const Eigen::VectorXd &joint_velocities) const override;
    Eigen::VectorXd getGravityVector(const Eigen::VectorXd &joint_positions) const override;
    Eigen::VectorXd getFrictionVector(const Eigen::VectorXd &joint_velocities) const override;
    Eigen::VectorXd getExternalTorques(const Eigen::VectorXd &joint_positions,
        const Eigen::Matrix<double, 6, 1> &external_wrench) const override;
    Eigen::VectorXd getTorques(const Eigen::VectorXd &joint_positions,
        const Eigen::VectorXd &joint_velocities, const Eigen::VectorXd &joint_accelerations,
        const Eigen::Matrix<double, 6, 1> &external_wrench =
            Eigen::Matrix<double, 6, 1>::Zero()) const override;

  private:
    bool initialized_ = false;
};

} // namespace flexgen_space

#endif // FLEXGEN_MODEL__INVERSE_DYNAMICS_HPP_
