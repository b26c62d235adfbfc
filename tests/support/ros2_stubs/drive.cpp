// Drive the exported plugin and controller as ROS 2 does, and write down what they give, bit for
// bit. For the tests.
//
//   drive plugin       reads q, v, a, wrench (3 n_a + 6 numbers) per point; writes tau, c, g, f,
//   external, M drive controller   reads chained, queue, n, gains and torque_max (4 n_m), start
//   tolerance, then per update the
//                      positions (n_m), whether there is a sample, and the sample (with the part
//                      force whether there is a wrench, and the wrench); writes the efforts, then
//                      the number of allocations in all updates
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <vector>

#include "flexgen_model/arm.hpp"
#include "flexgen_model/inverse_dynamics.hpp"
#include "flexgen_model/stream_controller.hpp"
#include <pluginlib/class_loader.hpp>

static long allocations = 0;
static bool counting = false;

extern "C" void *__libc_malloc(std::size_t size);
extern "C" void *malloc(std::size_t size)
{
    allocations += counting;
    return __libc_malloc(size);
}
extern "C" void *__libc_calloc(std::size_t n, std::size_t size);
extern "C" void *calloc(std::size_t n, std::size_t size)
{
    allocations += counting;
    return __libc_calloc(n, size);
}
extern "C" void *__libc_realloc(void *old, std::size_t size);
extern "C" void *realloc(void *old, std::size_t size)
{
    allocations += counting;
    return __libc_realloc(old, size);
}
extern "C" void *__libc_memalign(std::size_t alignment, std::size_t size);
extern "C" void *aligned_alloc(std::size_t alignment, std::size_t size)
{
    allocations += counting;
    return __libc_memalign(alignment, size);
}

static std::vector<double> read_all()
{
    std::vector<double> x;
    double entry;
    while (std::fread(&entry, sizeof entry, 1, stdin) == 1) {
        x.push_back(entry);
    }
    return x;
}

template <typename Array> static void write(const Array &x)
{
    std::fwrite(x.data(), sizeof(double), static_cast<std::size_t>(x.size()), stdout);
}

static int plugin()
{
    pluginlib::ClassLoader<inverse_dynamics_interface::InverseDynamicsInterface> loader("", "");
    const auto arm = loader.createUniqueInstance("flexgen_model/InverseDynamics");
    const Eigen::VectorXd zero = Eigen::VectorXd::Zero(MODEL_NA),
                          short_one = Eigen::VectorXd::Zero(MODEL_NA + 1);
    bool refused = false;
    try {
        arm->getTorques(zero, zero, zero);
    } catch (const std::runtime_error &) {
        refused = true;
    }
    arm->initialize(nullptr, "", "");
    try {
        arm->getTorques(zero, short_one, zero);
        return 3;
    } catch (const std::invalid_argument &) {
    }
    try {
        arm->getTorques(zero, zero * std::nan(""), zero);
        return 4;
    } catch (const std::runtime_error &) {
    }
    if (!refused) {
        return 2;
    }
    const auto x = read_all();
    const std::size_t row = 3 * MODEL_NA + 6;
    for (std::size_t k = 0; k + row <= x.size(); k += row) {
        const Eigen::VectorXd q = Eigen::Map<const Eigen::VectorXd>(&x[k], MODEL_NA);
        const Eigen::VectorXd v = Eigen::Map<const Eigen::VectorXd>(&x[k + MODEL_NA], MODEL_NA);
        const Eigen::VectorXd a = Eigen::Map<const Eigen::VectorXd>(
            &x[k + 2 * MODEL_NA], MODEL_NA);
        const Eigen::Matrix<double, 6, 1> wrench = Eigen::Map<const Eigen::Matrix<double, 6, 1>>(
            &x[k + row - 6]);
        write(arm->getTorques(q, v, a));
        write(arm->getTorques(q, v, a, wrench));
        const auto [M, c, g] = arm->getDynamicParameters(q, v);
        write(c);
        write(g);
        write(arm->getFrictionVector(v));
        write(arm->getExternalTorques(q, wrench));
        write(M);
    }
    return 0;
}

static int controller()
{
    const auto x = read_all();
    std::size_t at = 0;
    const auto next = [&]() { return x.at(at++); };
    const auto vector = [&](int n) {
        std::vector<double> out;
        for (int i = 0; i < n; ++i) {
            out.push_back(next());
        }
        return out;
    };
    const bool chained = next() != 0;
    const int queue = static_cast<int>(next()), updates = static_cast<int>(next());
    pluginlib::ClassLoader<controller_interface::ChainableControllerInterface> loader("", "");
    const auto made = loader.createUniqueInstance("flexgen_model/StreamController");
    auto *const stream = static_cast<flexgen_model::StreamController *>(made.get());
    using Result = controller_interface::CallbackReturn;
    if (stream->on_init() != Result::SUCCESS) {
        return 1;
    }
    auto &parameters = stream->get_node()->parameters;
#if MODEL_POSITION
    const int each = static_cast<int>(next());
    parameters["samples_per_position"] = std::int64_t{3};
    if (stream->on_configure({}) != Result::FAILURE) {
        return 15; // no divisor
    }
    parameters["samples_per_position"] = static_cast<std::int64_t>(each);
    parameters["positions_ahead"] = static_cast<std::int64_t>(next());
    parameters["interpolation"] = std::string("square");
    if (stream->on_configure({}) != Result::FAILURE) {
        return 16;
    }
    parameters["interpolation"] = std::string(next() != 0 ? "cubic" : "linear");
#else /* MODEL_POSITION */
    if (stream->on_configure({}) != Result::FAILURE) {
        return 2; // without gains
    }
    for (const char *name : {"position_gain", "speed_gain", "integral_gain", "torque_max"}) {
        parameters[name] = vector(MODEL_NM);
    }
#endif /* MODEL_POSITION */
    parameters["start_tolerance"] = next();
    parameters["queue"] = static_cast<std::int64_t>(queue);
#if MODEL_LIMITED
    const auto most = parameters["limits.torque_max"];
    parameters["limits.torque_max"] = std::vector<double>(MODEL_NM + 1, 1.0);
    if (stream->on_configure({}) != Result::FAILURE) {
        return 17; // a limit too many
    }
    parameters["limits.torque_max"] = most;
#endif /* MODEL_LIMITED */
    made->stub_set(999);
    if (stream->on_configure({}) != Result::FAILURE) {
        return 3; // another update rate
    }
#if MODEL_POSITION
    made->stub_set(static_cast<unsigned int>(
        0.5 + flexgen_model::SAMPLES_PER_INTERVAL / MODEL_STREAM_PERIOD / each));
#else /* MODEL_POSITION */
    made->stub_set(static_cast<unsigned int>(
        0.5 + MODEL_STREAM_SAMPLES_PER_INTERVAL / MODEL_STREAM_PERIOD));
#endif /* MODEL_POSITION */
    if (stream->on_configure({}) != Result::SUCCESS ||
        stream->get_node()->topics.at(0) != "~/reference") {
        return 4;
    }
    auto references = made->export_reference_interfaces();
    if (references.size() != flexgen_model::StreamController::SAMPLE ||
        references.at(0).get_name() != "stream_controller/output/y_0" ||
#if MODEL_FORCE
        references.back().get_name() !=
            "stream_controller/output/ddf_" + std::to_string(MODEL_NY - 1)) {
#else /* MODEL_FORCE */
        references.back().get_name() !=
            "stream_controller/output/ddy_" + std::to_string(MODEL_NY - 1)) {
#endif /* MODEL_FORCE */
        return 5;
    }
    std::vector<double> positions(MODEL_NM, 0.0), efforts(MODEL_NM, 0.0);
    std::vector<hardware_interface::LoanedCommandInterface> commands;
    std::vector<hardware_interface::LoanedStateInterface> states;
    for (std::size_t j = 0; j < MODEL_NM; ++j) {
        commands.emplace_back(&efforts[j]);
        states.emplace_back(&positions[j]);
    }
    made->assign_interfaces(std::move(commands), std::move(states));
#if MODEL_POSITION
    const std::string commanded = "/position";
#else /* MODEL_POSITION */
    const std::string commanded = "/effort";
#endif /* MODEL_POSITION */
    if (stream->command_interface_configuration().names.at(0) != FIRST_MOTOR + commanded) {
        return 6;
    }
    made->set_chained_mode(chained);
    std::vector<double> now = vector(MODEL_NM);
    std::copy(now.begin(), now.end(), positions.begin()); // the interfaces point to it
    const Result activated = stream->on_activate({});
    if (activated != Result::SUCCESS) {
        return 10;
    }
    const auto at_zero = [&]() {
        return std::all_of(
            efforts.begin(), efforts.end(), [](double effort) { return effort == 0.0; });
    };
#if MODEL_FORCE
    if (stream->push_wrench({0.0, 0.0, 0.0, 1.0, 0.0, 0.0}) ||
        stream->push_wrench({std::nan(""), 0, 0, 0, 0, 0}) ||
        stream->get_node()->topics.at(1) != "~/wrench") {
        return 8;
    }
#endif /* MODEL_FORCE */
    for (int k = 0; k < updates; ++k) {
        now = vector(MODEL_NM);
        std::copy(now.begin(), now.end(), positions.begin());
        const bool given = next() != 0;
        const auto sample = vector(flexgen_model::StreamController::SAMPLE);
#if MODEL_FORCE
        const bool pushed = next() != 0;
        const auto w = vector(6);
        if (pushed && !stream->push_wrench({w[0], w[1], w[2], w[3], w[4], w[5]})) {
            return 14;
        }
#endif /* MODEL_FORCE */
        if (given && chained) {
            for (std::size_t i = 0; i < sample.size(); ++i) {
                *references[i].value() = sample[i];
            }
        } else if (given && !stream->enqueue(sample)) {
            return 7;
        }
        counting = true;
        const auto status = made->update({}, {});
        counting = false;
        if (status != controller_interface::return_type::OK) {
            return at_zero() ? 11 : 12;
        }
        write(efforts);
    }
    stream->on_deactivate({});
#if MODEL_POSITION
    if (at_zero()) {
        return 13; // the last positions stay
    }
#else /* MODEL_POSITION */
    if (!at_zero()) {
        return 13;
    }
#endif /* MODEL_POSITION */
    const std::vector<double> last = {static_cast<double>(allocations)};
    write(last);
    return 0;
}

int main(int argc, char **argv)
{
    counting = true; // the counter counts
    std::free(std::malloc(1));
    counting = false;
    if (allocations != 1) {
        return 9;
    }
    allocations = 0;
    return argc > 1 && std::string(argv[1]) == "plugin" ? plugin() : controller();
}
