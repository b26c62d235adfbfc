// Position and speed control of every motor with feedforward torque. Written by flexgen.
//
//   w = v_ref + position_gain (q_ref - q) - v,    u = tau_ff + speed_gain (w + integral_gain int w
//   dt)
//
// The speed is the difference of two samples of the measured angle, and of the reference the same.
// Above the largest torque the integral does not grow.
#ifndef FLEXGEN_MODEL__CASCADE_HPP_
#define FLEXGEN_MODEL__CASCADE_HPP_

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

namespace flexgen_space
{

template <std::size_t N> struct Cascade {
    using Vector = std::array<double, N>;

    Vector position_gain{}; // [1/s]
    Vector speed_gain{};    // [N m s/rad]
    Vector integral_gain{}; // [1/s]
    Vector torque_max{};    // [N m]; 0: no limit
    double sample_time = 0.0;

    // Begin at rest at measured angles. They may differ from the reference: the difference is no
    // speed.
    void reset(const Vector &q, const Vector &q_ref)
    {
        q_before_ = q;
        q_ref_before_ = q_ref;
        sum_.fill(0.0);
    }

    // The torques of this sample, within the largest torques.
    Vector step(const Vector &q, const Vector &q_ref, const Vector &tau_ff)
    {
        Vector tau{};
        for (std::size_t j = 0; j < N; ++j) {
            const double v = (q[j] - q_before_[j]) / sample_time;
            const double v_ref = (q_ref[j] - q_ref_before_[j]) / sample_time;
            const double w = v_ref + position_gain[j] * (q_ref[j] - q[j]) - v;
            const double sum = sum_[j] + w * sample_time;
            const double u = tau_ff[j] + speed_gain[j] * (w + integral_gain[j] * sum);
            const bool full = torque_max[j] > 0.0 && std::abs(u) > torque_max[j] &&
                              (u > 0.0) == (w > 0.0);
            sum_[j] = full ? sum - w * sample_time : sum;
            tau[j] = torque_max[j] > 0.0 ? std::clamp(u, -torque_max[j], torque_max[j]) : u;
            q_before_[j] = q[j];
            q_ref_before_[j] = q_ref[j];
        }
        return tau;
    }

  private:
    Vector q_before_{}, q_ref_before_{}, sum_{};
};

} // namespace flexgen_space

#endif // FLEXGEN_MODEL__CASCADE_HPP_
