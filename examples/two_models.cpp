// Two generated libraries in one C++ program: the planar arm `planar5_nmp` and the two-joint arm
// `elbow`.
//
// Every symbol, type and macro of a library starts with the name of its model. The headers are C++
// as well as C. For each arm the program evaluates the gravity torques of many poses with one call
// of the batch function, whose arrays are structures of arrays (entry i of pose k is [i * n + k]).
// It prints the largest torque of each actuated joint.
//
//   flexgen generate planar5_nmp && flexgen generate elbow
//   cc -std=c99 -O2 -ffp-contract=off -c generated/planar5_nmp/src/*.c generated/elbow/src/*.c
//   c++ -Igenerated/planar5_nmp -Igenerated/elbow examples/two_models.cpp *.o -lm -o two_models &&
//   ./two_models
#include "elbow_batch.h"
#include "planar5_nmp_batch.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <vector>

namespace {

// Poses on a grid of angles from -pi to pi in the first two coordinates, the others straight.
template <typename Real>
std::vector<Real> grid(int coordinates, int per_axis)
{
    const int n = per_axis * per_axis;
    std::vector<Real> q(static_cast<std::size_t>(coordinates * n), Real(0));
    for (int k = 0; k < n; ++k) {
        const int at[2] = {k % per_axis, k / per_axis};
        for (int i = 0; i < 2; ++i) {
            q[static_cast<std::size_t>(i * n + k)] = Real(
                3.14159265358979 * (2.0 * at[i] / (per_axis - 1) - 1.0));
        }
    }
    return q;
}

// Evaluate the gravity torques of all poses; false where the library reports a failure.
template <typename Real, typename Gravity, typename Text>
bool show(const char *name, int coordinates, int work, Gravity gravity, Text text)
{
    const int per_axis = 51, n = per_axis * per_axis;
    const std::vector<Real> q = grid<Real>(coordinates, per_axis);
    std::vector<Real> g(q.size()), space(static_cast<std::size_t>(work));
    const auto status = gravity(n, q.data(), g.data(), space.data());
    if (status != 0) {
        std::fprintf(stderr, "%s: %s\n", name, text(status));
        return false;
    }
    for (int i = 0; i < coordinates; ++i) {
        Real largest = 0;
        for (int k = 0; k < n; ++k) {
            largest = std::max(largest, std::abs(g[static_cast<std::size_t>(i * n + k)]));
        }
        std::printf("%-12s coordinate %d holds at most %8.2f N m in %d poses\n", name, i,
            double(largest), n);
    }
    return true;
}

} // namespace

int main()
{
    const bool planar = show<planar5_nmp_real>("planar5_nmp", PLANAR5_NMP_NA,
        planar5_nmp_batch_work(), planar5_nmp_gravity_batch, planar5_nmp_status_text);
    const bool elbow = show<elbow_real>("elbow", ELBOW_NA, elbow_batch_work(), elbow_gravity_batch,
                                        elbow_status_text);
    return planar && elbow ? 0 : 1;
}
