#if MODEL_POSITION
// Positions for the servos of a robot from a stream of inverse dynamics, as a chainable
// controller. Written by flexgen.
#else /* MODEL_POSITION */
// Inverse dynamics of a stream with P-PI control of the motors, as a chainable controller.
// Written by flexgen.
#endif /* MODEL_POSITION */
#ifndef FLEXGEN_MODEL__STREAM_CONTROLLER_HPP_
#define FLEXGEN_MODEL__STREAM_CONTROLLER_HPP_

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <controller_interface/chainable_controller_interface.hpp>
#if MODEL_FORCE
#include <geometry_msgs/msg/wrench_stamped.hpp>
#endif /* MODEL_FORCE */
#include <rclcpp/rclcpp.hpp>
#include <rclcpp_lifecycle/state.hpp>
#include <std_msgs/msg/float64_multi_array.hpp>

#if MODEL_POSITION
#include "flexgen_model/position_window.hpp"
#else /* MODEL_POSITION */
#include "flexgen_model/cascade.hpp"
#endif /* MODEL_POSITION */
#if MODEL_FORCE
#include "flexgen_model/force_ramp.hpp"
#endif /* MODEL_FORCE */
#include "flexgen_model/model.h"
#include "flexgen_model/sample_queue.hpp"

namespace flexgen_space
{

// A sample of the path has the output, its first and its second time derivative: y, dy, ddy. The
// output reaches it `intervals` intervals later. An interval of the stream has
// `samples_per_interval` updates of the controller, and takes one sample at its first update: in
// chained mode from the reference interfaces, else from the topic ~/reference, whose messages have
// one or more samples. Where there is none, or not all of its numbers are finite, the output stays
// where it is: end a path at rest.
#if MODEL_FORCE
//
// A sample also has the force on the output, dual to its rates, and its first and second time
// derivative: f, df, ddf. The topic ~/wrench adds a force and a torque on the tool in world axes,
// which change within the time wrench_time to those of the last message. The force of a sample and
// that of the topic act where the output reaches the sample. When the controller is activated they
// are zero.
#endif /* MODEL_FORCE */
#if MODEL_LIMITED
//
// The stream modifies the path to keep the parameters limits.NAME, see stream_all_limits of the
// library.
#endif /* MODEL_LIMITED */
//
#if MODEL_POSITION
// An update has `samples_per_position` samples of the servo of the robot, whose gains are those of
// the model file, and the robot interpolates from the position of an update to that of the next.
//
// Where update returns an error, and where the controller is deactivated, the robot keeps its last
// position.
#else /* MODEL_POSITION */
// Where update returns an error, and where the controller is deactivated, the efforts are set to
// 0.
#endif /* MODEL_POSITION */
//
// update neither allocates nor waits, and has a bounded number of operations.
class StreamController : public controller_interface::ChainableControllerInterface
{
  public:
#if MODEL_FORCE
    static constexpr int SAMPLE = MODEL_NT + 5 * MODEL_NY; // numbers of a sample
#else /* MODEL_FORCE */
    static constexpr int SAMPLE = MODEL_NT + 2 * MODEL_NY; // numbers of a sample
#endif /* MODEL_FORCE */

    controller_interface::InterfaceConfiguration command_interface_configuration() const override;
    controller_interface::InterfaceConfiguration state_interface_configuration() const override;
    controller_interface::CallbackReturn on_init() override;
    controller_interface::CallbackReturn on_configure(
        const rclcpp_lifecycle::State &previous_state) override;
    controller_interface::CallbackReturn on_activate(
        const rclcpp_lifecycle::State &previous_state) override;
    controller_interface::CallbackReturn on_deactivate(
        const rclcpp_lifecycle::State &previous_state) override;
    controller_interface::return_type update_and_write_commands(
        const rclcpp::Time &time, const rclcpp::Duration &period) override;

    // Put the samples of a message in the queue: false, and none of them, where the size is wrong
    // or there is no room.
    bool enqueue(const std::vector<double> &samples);

#if MODEL_FORCE
    // Take a force and a torque on the tool: false where one is not finite, where the output has
    // no such component, or where there is no room.
    bool push_wrench(const std::array<double, 6> &wrench);

#endif /* MODEL_FORCE */
    // Of the last interval.
    const model_stream_info &info() const
    {
        return info_;
    }

  protected:
    std::vector<hardware_interface::CommandInterface> on_export_reference_interfaces() override;
    bool on_set_chained_mode(bool chained_mode) override;
    controller_interface::return_type update_reference_from_subscribers(
        const rclcpp::Time &time, const rclcpp::Duration &period) override;

  private:
    using Motors = std::array<double, MODEL_NM>;

    bool read_parameters();
#if MODEL_LIMITED
    bool read_limits();
#endif /* MODEL_LIMITED */
    bool measure();
#if MODEL_POSITION
    bool read_interface();
#else /* MODEL_POSITION */
    bool release_motors();
#endif /* MODEL_POSITION */
    int begin_interval();
#if MODEL_FORCE
    void give_force(const double *sample);
#endif /* MODEL_FORCE */

    std::vector<std::string> joints_;
    Motors gear_ratio_{}, offset_{}, measured_{};
    double start_tolerance_ = 0.0;
    std::vector<double> start_output_, q_start_;
    model_stream_options options_{};
#if MODEL_LIMITED
    std::vector<std::vector<double>> bounds_;
    model_inversion_limits limits_{}; // of these bounds
    double deviation_max_ = 0.0;
#endif /* MODEL_LIMITED */
#if MODEL_POSITION
    model_servo servo_{};
    model_robot_interface robot_{};
    PositionWindow window_;

    std::vector<double> memory_, q_m_, tau_m_, command_m_; // of the stream; of an interval
#else /* MODEL_POSITION */
    Cascade<MODEL_NM> cascade_;

    std::vector<double> memory_, q_m_, tau_m_; // of the stream; of an interval
#endif /* MODEL_POSITION */
    model_stream stream_{};                    // in this memory
    std::array<double, SAMPLE> held_{};        // the last sample, at rest
    model_stream_info info_{};
    int part_ = 0; // of the interval
    std::uint64_t warnings_ = 0, missing_ = 0;

    SampleQueue<SAMPLE> queue_;
    rclcpp::Subscription<std_msgs::msg::Float64MultiArray>::SharedPtr subscription_;
#if MODEL_FORCE

    ForceRamp<MODEL_NY> ramp_;
    std::array<double, 3 * MODEL_NY> pushing_{}; // of the topic, in this interval
    SampleQueue<MODEL_NY> wrenches_;
    rclcpp::Subscription<geometry_msgs::msg::WrenchStamped>::SharedPtr wrench_subscription_;
#endif /* MODEL_FORCE */
};

} // namespace flexgen_space

#endif // FLEXGEN_MODEL__STREAM_CONTROLLER_HPP_
