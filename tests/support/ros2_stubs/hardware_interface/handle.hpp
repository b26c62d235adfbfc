#ifndef STUB_HANDLE_HPP
#define STUB_HANDLE_HPP
#include <optional>
#include <string>

namespace hardware_interface
{
class CommandInterface
{
public:
    CommandInterface(const std::string &prefix, const std::string &name, double *value)
        : name_(prefix + "/" + name), value_(value)
    {
    }
    CommandInterface(const CommandInterface &) = delete;
    CommandInterface(CommandInterface &&) = default;
    const std::string &get_name() const
    {
        return name_;
    }
    double *value() const
    {
        return value_;
    }

private:
    std::string name_;
    double *value_;
};
class LoanedCommandInterface
{
public:
    explicit LoanedCommandInterface(double *value) : value_(value)
    {
    }
    LoanedCommandInterface(const LoanedCommandInterface &) = delete;
    LoanedCommandInterface(LoanedCommandInterface &&) = default;
    template <typename T> [[nodiscard]] bool set_value(const T &value, unsigned int = 10)
    {
        *value_ = value;
        return true;
    }

private:
    double *value_;
};
class LoanedStateInterface
{
public:
    explicit LoanedStateInterface(const double *value) : value_(value)
    {
    }
    LoanedStateInterface(const LoanedStateInterface &) = delete;
    LoanedStateInterface(LoanedStateInterface &&) = default;
    template <typename T = double>
    [[nodiscard]] std::optional<T> get_optional(unsigned int = 10) const
    {
        return *value_;
    }

private:
    const double *value_;
};
} // namespace hardware_interface
#endif
