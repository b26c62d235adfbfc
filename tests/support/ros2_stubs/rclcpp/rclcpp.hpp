#ifndef STUB_RCLCPP_HPP
#define STUB_RCLCPP_HPP
#include <cstdarg>
#include <cstdint>
#include <cstdio>
#include <functional>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <variant>
#include <vector>

namespace rclcpp
{
class Time
{
};
class Duration
{
};
struct Logger {
};
struct QoS {
};
struct SystemDefaultsQoS : QoS {
};
template <typename Message> struct Subscription {
    using SharedPtr = std::shared_ptr<Subscription>;
    std::function<void(std::shared_ptr<Message>)> callback;
};
using Value = std::variant<bool, std::int64_t, double, std::string, std::vector<double>,
    std::vector<std::string>>;
class Parameter
{
public:
    explicit Parameter(const Value &value) : value_(value)
    {
    }
    double as_double() const
    {
        return std::get<double>(value_);
    }
    std::int64_t as_int() const
    {
        return std::get<std::int64_t>(value_);
    }
    std::vector<double> as_double_array() const
    {
        return std::get<std::vector<double>>(value_);
    }
    std::string as_string() const
    {
        return std::get<std::string>(value_);
    }
    std::vector<std::string> as_string_array() const
    {
        return std::get<std::vector<std::string>>(value_);
    }

private:
    Value value_;
};
} // namespace rclcpp

namespace stub
{
inline std::string &last_message()
{
    static std::string text;
    return text;
}
__attribute__((format(printf, 1, 2))) inline void log(const char *format, ...)
{
    char text[1024];
    va_list arguments;
    va_start(arguments, format);
    std::vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    last_message() = text;
    std::fprintf(stderr, "%s\n", text);
}
} // namespace stub

#define RCLCPP_ERROR(logger, ...) ((void)(logger), stub::log(__VA_ARGS__))
#define RCLCPP_WARN(logger, ...) ((void)(logger), stub::log(__VA_ARGS__))
#endif
