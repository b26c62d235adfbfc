#ifndef STUB_NODE_PARAMETERS_INTERFACE_HPP
#define STUB_NODE_PARAMETERS_INTERFACE_HPP
#include <memory>
namespace rclcpp::node_interfaces
{
class NodeParametersInterface
{
public:
    using ConstSharedPtr = std::shared_ptr<const NodeParametersInterface>;
    virtual ~NodeParametersInterface() = default;
};
} // namespace rclcpp::node_interfaces
#endif
