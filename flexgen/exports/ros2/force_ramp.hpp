// A force that follows messages smoothly. Written by flexgen.
#ifndef FLEXGEN_MODEL__FORCE_RAMP_HPP_
#define FLEXGEN_MODEL__FORCE_RAMP_HPP_

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

namespace flexgen_space
{

// From one value to the next one within a time, with two continuous derivatives:
// f = f_0 + (f_1 - f_0) s(u), s = u^3 (10 - 15 u + 6 u^2). A new value waits until the last change
// is over.
template <std::size_t N> class ForceRamp
{
  public:
    using Force = std::array<double, N>;

    // Time of a change and of a step [s].
    void set_times(double change, double step)
    {
        steps_ = std::max(1.0, std::round(change / step));
        change_ = steps_ * step;
    }

    // To zero, without a change.
    void reset()
    {
        from_ = to_ = next_ = Force{};
        at_ = steps_;
    }

    void set_next(const Force &force)
    {
        next_ = force;
    }

    // The next step: value, first and second time derivative, one after the other.
    std::array<double, 3 * N> step()
    {
        if (at_ >= steps_) {
            from_ = to_;
            to_ = next_;
            at_ = 0.0;
        }
        at_ += 1.0;
        const double u = at_ / steps_, v = 1.0 - u;
        const double s = u * u * u * (10.0 - 15.0 * u + 6.0 * u * u);
        const double ds = 30.0 * u * u * v * v / change_,
                     dds = 60.0 * u * v * (v - u) / (change_ * change_);
        std::array<double, 3 * N> out{};
        for (std::size_t i = 0; i < N; ++i) {
            const double size = to_[i] - from_[i];
            out[i] = from_[i] + size * s;
            out[N + i] = size * ds;
            out[2 * N + i] = size * dds;
        }
        return out;
    }

  private:
    Force from_{}, to_{}, next_{};
    double steps_ = 1.0, change_ = 1.0, at_ = 1.0;
};

} // namespace flexgen_space

#endif // FLEXGEN_MODEL__FORCE_RAMP_HPP_
