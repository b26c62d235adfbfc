#ifndef STUB_LIFECYCLE_NODE_HPP
#define STUB_LIFECYCLE_NODE_HPP
#include <rclcpp/rclcpp.hpp>
#include <rclcpp_lifecycle/state.hpp>

namespace rclcpp_lifecycle
{
class LifecycleNode
{
public:
    explicit LifecycleNode(const std::string &name) : name_(name)
    {
    }
    const char *get_name() const
    {
        return name_.c_str();
    }
    rclcpp::Logger get_logger() const
    {
        return {};
    }
    rclcpp::Parameter get_parameter(const std::string &name) const
    {
        return rclcpp::Parameter(parameters.at(name));
    }
    template <typename Message, typename Callback>
    typename rclcpp::Subscription<Message>::SharedPtr create_subscription(
        const std::string &topic, const rclcpp::QoS &, Callback &&callback)
    {
        topics.push_back(topic);
        auto made = std::make_shared<rclcpp::Subscription<Message>>();
        made->callback = callback;
        return made;
    }
    std::map<std::string, rclcpp::Value> parameters;
    std::vector<std::string> topics;

private:
    std::string name_;
};
} // namespace rclcpp_lifecycle
#endif
