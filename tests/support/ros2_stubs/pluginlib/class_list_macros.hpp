#ifndef STUB_CLASS_LIST_MACROS_HPP
#define STUB_CLASS_LIST_MACROS_HPP
#include <functional>
#include <map>
#include <string>
#include <type_traits>

namespace stub
{
inline std::map<std::string, std::function<void *()>> &classes()
{
    static std::map<std::string, std::function<void *()>> found;
    return found;
}
} // namespace stub

#define PLUGINLIB_EXPORT_CLASS(Derived, Base) \
    static_assert(std::is_base_of_v<Base, Derived> && std::is_default_constructible_v<Derived>); \
    [[maybe_unused]] static const bool stub_registered = \
        stub::classes() \
            .emplace(#Derived, []() -> void * { return static_cast<Base *>(new Derived()); }) \
            .second;
#endif
