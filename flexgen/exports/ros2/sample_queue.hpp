// A queue of samples of fixed size between one writer and one reader. Written by flexgen.
#ifndef FLEXGEN_MODEL__SAMPLE_QUEUE_HPP_
#define FLEXGEN_MODEL__SAMPLE_QUEUE_HPP_

#include <array>
#include <atomic>
#include <cstddef>
#include <vector>

namespace flexgen_space
{

// push is called by one thread, pop by another one; neither waits or allocates.
template <std::size_t N> class SampleQueue
{
  public:
    using Sample = std::array<double, N>;

    // Not while others use it.
    void resize(std::size_t samples)
    {
        samples_.assign(samples + 1, Sample{});
        read_ = 0;
        write_ = 0;
    }

    // Room for further samples.
    std::size_t room() const
    {
        const std::size_t n = samples_.size();
        return n == 0 ? 0 : (read_.load() + n - write_.load() - 1) % n;
    }

    bool push(const double *sample)
    {
        if (room() == 0) {
            return false;
        }
        const std::size_t at = write_.load();
        for (std::size_t i = 0; i < N; ++i) {
            samples_[at][i] = sample[i];
        }
        write_.store((at + 1) % samples_.size());
        return true;
    }

    bool pop(double *sample)
    {
        const std::size_t at = read_.load();
        if (samples_.empty() || at == write_.load()) {
            return false;
        }
        for (std::size_t i = 0; i < N; ++i) {
            sample[i] = samples_[at][i];
        }
        read_.store((at + 1) % samples_.size());
        return true;
    }

    // By the reader.
    void clear()
    {
        read_.store(write_.load());
    }

  private:
    std::vector<Sample> samples_;
    std::atomic<std::size_t> read_{0}, write_{0};
};

} // namespace flexgen_space

#endif // FLEXGEN_MODEL__SAMPLE_QUEUE_HPP_
