// Positions for a robot that interpolates between them, from the reference of its servo.
// Written by flexgen.
//
// The robot takes a position every so many samples of its servo. That in the middle of a window of
// the reference is sent: it depends on the samples before and after it, less with each position in
// between.
#ifndef FLEXGEN_MODEL__POSITION_WINDOW_HPP_
#define FLEXGEN_MODEL__POSITION_WINDOW_HPP_

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "flexgen_model/model.h"

namespace flexgen_space
{

class PositionWindow
{
  public:
    using Vector = std::array<double, MODEL_NG>;

    // A window with `sides` positions before and after the one that is sent; 0 where each sample
    // is a position. False for numbers that do not fit.
    bool resize(const model_robot_interface &robot, int sides)
    {
        const int each = robot.samples_per_position;
        if (each < 1 || each > 1000 || sides < (each > 1 ? 1 : 0) || sides > 100) {
            return false;
        }
        robot_ = robot;
        sides_ = each > 1 ? sides : 0;
        const int n = rows();
        const std::int64_t work = n > 1 ? model_position_samples_work(n, &robot_) : 0;
        if (work < 0) {
            return false;
        }
        kept_.assign(static_cast<std::size_t>(n) * MODEL_NG, 0.0);
        positions_.assign((2 * static_cast<std::size_t>(sides_) + 1) * MODEL_NG, 0.0);
        work_.assign(static_cast<std::size_t>(work), 0.0);
        return true;
    }

    // The robot rests at this reference.
    void fill(const double *reference)
    {
        for (std::size_t i = 0; i < kept_.size(); ++i) {
            kept_[i] = reference[i % MODEL_NG];
        }
    }

    // Take the samples of the reference until the next position, and give the position to send;
    // false: there is none.
    bool step(const double *references, Vector &position)
    {
        const std::size_t count = static_cast<std::size_t>(robot_.samples_per_position) * MODEL_NG;
        if (sides_ == 0) {
            std::copy_n(references, MODEL_NG, position.begin());
        } else {
            std::copy(
                kept_.begin() + static_cast<std::ptrdiff_t>(count), kept_.end(), kept_.begin());
            std::copy_n(references, count, kept_.end() - static_cast<std::ptrdiff_t>(count));
            if (model_position_samples(kept_.data(), rows(), &robot_, positions_.data(),
                    work_.data(), static_cast<std::int64_t>(work_.size())) < 0) {
                return false;
            }
            std::copy_n(positions_.begin() + static_cast<std::ptrdiff_t>(sides_) * MODEL_NG,
                MODEL_NG, position.begin());
        }
        return std::all_of(
            position.begin(), position.end(), [](double entry) { return std::isfinite(entry); });
    }

  private:
    int rows() const
    {
        return 2 * sides_ * robot_.samples_per_position + 1;
    }

    model_robot_interface robot_{};
    int sides_ = 0;
    std::vector<double> kept_, positions_,
        work_; // samples of the reference, one after the other; results
};

} // namespace flexgen_space

#endif // FLEXGEN_MODEL__POSITION_WINDOW_HPP_
