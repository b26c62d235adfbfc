#ifndef STUB_RCLCPP_EXCEPTIONS_HPP
#define STUB_RCLCPP_EXCEPTIONS_HPP
#include <stdexcept>
#endif
