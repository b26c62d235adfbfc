#ifndef STUB_CHAINABLE_CONTROLLER_INTERFACE_HPP
#define STUB_CHAINABLE_CONTROLLER_INTERFACE_HPP
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <hardware_interface/handle.hpp>
#include <rclcpp_lifecycle/lifecycle_node.hpp>

namespace controller_interface
{
enum class CallbackReturn : std::uint8_t { SUCCESS = 97, FAILURE = 98, ERROR = 99 };
enum class return_type : std::uint8_t { OK = 0, ERROR = 1 };
enum class interface_configuration_type : std::uint8_t { ALL = 0, INDIVIDUAL = 1, NONE = 2 };
struct InterfaceConfiguration {
    interface_configuration_type type;
    std::vector<std::string> names = {};
};

class ChainableControllerInterface
{
public:
    virtual ~ChainableControllerInterface() = default;
    virtual InterfaceConfiguration command_interface_configuration() const = 0;
    virtual InterfaceConfiguration state_interface_configuration() const = 0;
    virtual CallbackReturn on_init() = 0;
    virtual CallbackReturn on_configure(const rclcpp_lifecycle::State &)
    {
        return CallbackReturn::SUCCESS;
    }
    virtual CallbackReturn on_activate(const rclcpp_lifecycle::State &)
    {
        return CallbackReturn::SUCCESS;
    }
    virtual CallbackReturn on_deactivate(const rclcpp_lifecycle::State &)
    {
        return CallbackReturn::SUCCESS;
    }
    // What the controller manager calls in a cycle.
    return_type update(const rclcpp::Time &time, const rclcpp::Duration &period)
    {
        if (!chained_ && update_reference_from_subscribers(time, period) != return_type::OK) {
            return return_type::ERROR;
        }
        return update_and_write_commands(time, period);
    }
    std::vector<hardware_interface::CommandInterface> export_reference_interfaces()
    {
        return on_export_reference_interfaces();
    }
    bool set_chained_mode(bool chained)
    {
        chained_ = chained;
        return on_set_chained_mode(chained);
    }
    bool is_in_chained_mode() const
    {
        return chained_;
    }
    std::shared_ptr<rclcpp_lifecycle::LifecycleNode> get_node() const
    {
        return node_;
    }
    unsigned int get_update_rate() const
    {
        return rate_;
    }
    void assign_interfaces(std::vector<hardware_interface::LoanedCommandInterface> &&commands,
        std::vector<hardware_interface::LoanedStateInterface> &&states)
    {
        command_interfaces_ = std::move(commands);
        state_interfaces_ = std::move(states);
    }
    void stub_set(unsigned int rate)
    {
        rate_ = rate;
    }

protected:
    template <typename T> auto auto_declare(const std::string &name, const T &value)
    {
        if constexpr (std::is_same_v<T, int>) {
            node_->parameters.emplace(name, static_cast<std::int64_t>(value));
        } else {
            node_->parameters.emplace(name, value);
        }
        return value;
    }
    virtual std::vector<hardware_interface::CommandInterface> on_export_reference_interfaces() = 0;
    virtual bool on_set_chained_mode(bool)
    {
        return true;
    }
    virtual return_type update_reference_from_subscribers(
        const rclcpp::Time &, const rclcpp::Duration &) = 0;
    virtual return_type update_and_write_commands(
        const rclcpp::Time &, const rclcpp::Duration &) = 0;

    std::vector<double> reference_interfaces_;
    std::vector<hardware_interface::LoanedCommandInterface> command_interfaces_;
    std::vector<hardware_interface::LoanedStateInterface> state_interfaces_;

private:
    std::shared_ptr<rclcpp_lifecycle::LifecycleNode> node_ =
        std::make_shared<rclcpp_lifecycle::LifecycleNode>("stream_controller");
    unsigned int rate_ = 1000;
    bool chained_ = false;
};
} // namespace controller_interface
#endif
