#ifndef STUB_CLASS_LOADER_HPP
#define STUB_CLASS_LOADER_HPP
#include <memory>
#include <pluginlib/class_list_macros.hpp>

namespace pluginlib
{
template <typename Base> class ClassLoader
{
public:
    ClassLoader(const std::string &, const std::string &)
    {
    }
    std::unique_ptr<Base> createUniqueInstance(const std::string &lookup_name)
    {
        std::string type = lookup_name;
        type.replace(type.find('/'), 1, "::");
        return std::unique_ptr<Base>(static_cast<Base *>(stub::classes().at(type)()));
    }
};
} // namespace pluginlib
#endif
