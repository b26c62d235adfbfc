#ifndef STUB_INVERSE_DYNAMICS_EXCEPTIONS_HPP
#define STUB_INVERSE_DYNAMICS_EXCEPTIONS_HPP
#include <rclcpp/exceptions/exceptions.hpp>
namespace inverse_dynamics_interface
{
class UninitializedException : public std::runtime_error
{
public:
    UninitializedException() : std::runtime_error("not initialized")
    {
    }
};
} // namespace inverse_dynamics_interface
#endif
