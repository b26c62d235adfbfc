#ifndef STUB_WRENCH_STAMPED_HPP
#define STUB_WRENCH_STAMPED_HPP
#include <memory>
namespace geometry_msgs::msg
{
struct Vector3 {
    double x = 0.0, y = 0.0, z = 0.0;
};
struct Wrench {
    Vector3 force, torque;
};
struct WrenchStamped {
    using SharedPtr = std::shared_ptr<WrenchStamped>;
    Wrench wrench;
};
} // namespace geometry_msgs::msg
#endif
