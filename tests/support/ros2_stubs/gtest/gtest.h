#ifndef STUB_GTEST_H
#define STUB_GTEST_H
#include <cmath>
#include <iostream>
#include <sstream>

namespace stub
{
inline int &failures()
{
    static int n = 0;
    return n;
}
struct Said {
    bool failed;
    template <typename T> Said &operator<<(const T &x)
    {
        if (failed) {
            std::cerr << x;
        }
        return *this;
    }
};
inline Said near(double a, double b, double most)
{
    const bool failed = !(std::abs(a - b) <= most);
    failures() += failed;
    return {failed};
}
} // namespace stub

#define EXPECT_NEAR(a, b, most) stub::near(a, b, most)
#define TEST(suite, name) \
    static void suite##_##name(); \
    int main() \
    { \
        suite##_##name(); \
        return stub::failures(); \
    } \
    static void suite##_##name()
#endif
