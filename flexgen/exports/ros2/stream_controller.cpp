// Written by flexgen; see the header.
#include "flexgen_model/stream_controller.hpp"

#include <algorithm>
#include <cmath>
#include <exception>
#include <limits>
#include <string>
#include <vector>

#include <pluginlib/class_list_macros.hpp>

#include "flexgen_model/arm.hpp"

namespace flexgen_space
{
namespace
{

constexpr double NOT_A_NUMBER = std::numeric_limits<double>::quiet_NaN();
#if MODEL_FORCE
constexpr std::size_t WRENCHES = 64; // messages between two intervals
#endif /* MODEL_FORCE */

#if MODEL_LIMITED
// A limit of the stream: a parameter of so many numbers, one for each motor, gear or coordinate;
// of a curve any points.
struct Limit {
    const char *name;
    std::size_t size;
    const double *given;
    const double *model_inversion_limits::*member;
};

constexpr std::array<Limit, 8> LIMITS = {{
    {"limits.torque_max", MODEL_NM, LIMIT_TORQUE_MAX.data(), &model_inversion_limits::torque_max},
    {"limits.speed_max", MODEL_NM, LIMIT_SPEED_MAX.data(), &model_inversion_limits::speed_max},
    {"limits.torque_rate_max", MODEL_NM, LIMIT_TORQUE_RATE_MAX.data(),
        &model_inversion_limits::torque_rate_max},
    {"limits.deflection_max", MODEL_NE, LIMIT_DEFLECTION_MAX.data(),
        &model_inversion_limits::deflection_max},
    {"limits.gear_torque_max", MODEL_NG, LIMIT_GEAR_TORQUE_MAX.data(),
        &model_inversion_limits::gear_torque_max},
    {"limits.joint_speed_max", MODEL_NG, LIMIT_JOINT_SPEED_MAX.data(),
        &model_inversion_limits::joint_speed_max},
    {"limits.joint_acceleration_max", MODEL_NG, LIMIT_JOINT_ACCELERATION_MAX.data(),
        &model_inversion_limits::joint_acceleration_max},
    {"limits.torque_speed", LIMIT_TORQUE_SPEED.size(), LIMIT_TORQUE_SPEED.data(),
        &model_inversion_limits::torque_speed},
}};

#endif /* MODEL_LIMITED */
// A sample that the stream refuses changes nothing in it.
bool refused(int status)
{
    return status == MODEL_INPUT_NOT_FINITE || status == MODEL_BAD_ARGUMENT ||
           status == MODEL_UNREACHABLE;
}

bool finite(const std::vector<double> &x)
{
    return std::all_of(x.begin(), x.end(), [](double entry) { return std::isfinite(entry); });
}

} // namespace

controller_interface::CallbackReturn StreamController::on_init()
{
    try {
        auto_declare<std::vector<std::string>>(
            "joints", std::vector<std::string>(MOTORS.begin(), MOTORS.end()));
#if MODEL_POSITION
        auto_declare<int>("samples_per_position", 1);
        auto_declare<std::string>("interpolation", "linear");
        auto_declare<int>("positions_ahead", 8);
#else /* MODEL_POSITION */
        for (const char *name : {"position_gain", "speed_gain", "integral_gain"}) {
            auto_declare<std::vector<double>>(name, std::vector<double>());
        }
        auto_declare<std::vector<double>>(
            "torque_max", std::vector<double>(TORQUE_MAX.begin(), TORQUE_MAX.end()));
#endif /* MODEL_POSITION */
        auto_declare<std::vector<double>>("gear_ratio", std::vector<double>(MODEL_NM, 1.0));
        auto_declare<std::vector<double>>("offset", std::vector<double>(MODEL_NM, 0.0));
        auto_declare<std::vector<double>>(
            "start_output", std::vector<double>(START_OUTPUT.begin(), START_OUTPUT.end()));
        auto_declare<std::vector<double>>(
            "q_start", std::vector<double>(model_home_q_a, model_home_q_a + MODEL_NA));
        auto_declare<double>("start_tolerance", START_TOLERANCE);
        auto_declare<double>("period", MODEL_STREAM_PERIOD);
        auto_declare<int>("intervals", MODEL_STREAM_INTERVALS);
#if MODEL_POSITION
        auto_declare<int>("samples_per_interval", SAMPLES_PER_INTERVAL);
#else /* MODEL_POSITION */
        auto_declare<int>("samples_per_interval", MODEL_STREAM_SAMPLES_PER_INTERVAL);
#endif /* MODEL_POSITION */
        auto_declare<double>("tolerance", MODEL_STREAM_TOLERANCE);
#if MODEL_POSITION
#else /* MODEL_POSITION */
        auto_declare<double>("delay", 0.0);
#endif /* MODEL_POSITION */
        auto_declare<int>("queue", 1000);
#if MODEL_LIMITED
        for (const auto &limit : LIMITS) {
            auto_declare<std::vector<double>>(
                limit.name, std::vector<double>(limit.given, limit.given + limit.size));
        }
        auto_declare<double>("limits.tool_speed_max", LIMIT_TOOL_SPEED_MAX[0]);
        auto_declare<double>("limits.tool_acceleration_max", LIMIT_TOOL_ACCELERATION_MAX[0]);
        auto_declare<double>("limits.deviation_max", 0.05);
#endif /* MODEL_LIMITED */
#if MODEL_FORCE
        auto_declare<double>("wrench_time", 0.1);
#endif /* MODEL_FORCE */
    } catch (const std::exception &error) {
        RCLCPP_ERROR(get_node()->get_logger(), "parameters: %s", error.what());
        return controller_interface::CallbackReturn::ERROR;
    }
    return controller_interface::CallbackReturn::SUCCESS;
}

bool StreamController::read_parameters()
{
    const auto node = get_node();
    const auto logger = node->get_logger();
    const auto list = [&](const char *name, std::size_t size, bool not_negative) {
        auto x = node->get_parameter(name).as_double_array();
        const bool good = x.size() == size && finite(x) &&
                          (!not_negative || std::all_of(x.begin(), x.end(),
                                                [](double entry) { return entry >= 0.0; }));
        if (!good) {
            RCLCPP_ERROR(logger, "parameter %s: expected %zu finite numbers%s, given %zu numbers",
                name, size, not_negative ? " >= 0" : "", x.size());
            x.clear();
        }
        return x;
    };
    joints_ = node->get_parameter("joints").as_string_array();
    if (joints_.size() != MODEL_NM) {
        RCLCPP_ERROR(logger, "parameter joints: expected %d names, one for each motor, given %zu",
            MODEL_NM, joints_.size());
        return false;
    }
    const auto copy = [&](const char *name, bool not_negative, Motors &to) {
        const auto x = list(name, MODEL_NM, not_negative);
        if (x.empty()) {
            return false;
        }
        std::copy(x.begin(), x.end(), to.begin());
        return true;
    };
#if MODEL_POSITION
    if (!copy("gear_ratio", false, gear_ratio_) || !copy("offset", false, offset_)) {
#else /* MODEL_POSITION */
    if (!copy("position_gain", true, cascade_.position_gain) ||
        !copy("speed_gain", true, cascade_.speed_gain) ||
        !copy("integral_gain", true, cascade_.integral_gain) ||
        !copy("torque_max", true, cascade_.torque_max) ||
        !copy("gear_ratio", false, gear_ratio_) || !copy("offset", false, offset_)) {
#endif /* MODEL_POSITION */
        return false;
    }
    if (std::any_of(
            gear_ratio_.begin(), gear_ratio_.end(), [](double ratio) { return ratio == 0.0; })) {
        RCLCPP_ERROR(logger, "parameter gear_ratio: expected numbers other than 0");
        return false;
    }
    start_output_ = list("start_output", MODEL_NT, false);
    q_start_ = list("q_start", MODEL_NA, false);
    start_tolerance_ = node->get_parameter("start_tolerance").as_double();
    options_.period = node->get_parameter("period").as_double();
    options_.intervals = static_cast<int>(node->get_parameter("intervals").as_int());
    options_.samples_per_interval = static_cast<int>(
        node->get_parameter("samples_per_interval").as_int());
    options_.tolerance = node->get_parameter("tolerance").as_double();
    options_.hold = MODEL_HOLD_ZOH;
#if MODEL_LIMITED
    if (!read_limits()) {
        return false;
    }
#endif /* MODEL_LIMITED */
#if MODEL_POSITION
    servo_ = model_servo_defaults();
    options_.servo = &servo_;
    options_.delay = servo_.delay / servo_.sample_time;
    return !start_output_.empty() && !q_start_.empty() && read_interface();
#else /* MODEL_POSITION */
    options_.delay = node->get_parameter("delay").as_double();
    return !start_output_.empty() && !q_start_.empty();
#endif /* MODEL_POSITION */
}

#if MODEL_LIMITED
bool StreamController::read_limits()
{
    const auto node = get_node();
    const auto logger = node->get_logger();
    bounds_.assign(LIMITS.size(), {});
    limits_ = {};
    for (std::size_t i = 0; i < LIMITS.size(); ++i) {
        const Limit &limit = LIMITS[i];
        auto &x = bounds_[i];
        x = node->get_parameter(limit.name).as_double_array();
        const bool curve = limit.member == &model_inversion_limits::torque_speed;
        const bool fits = curve ? x.size() % (2 * MODEL_NM) == 0 : x.size() == limit.size;
        if (!fits || !finite(x) ||
            std::any_of(x.begin(), x.end(), [](double entry) { return entry < 0.0; })) {
            RCLCPP_ERROR(logger,
                "parameter %s: expected %s%zu finite numbers >= 0, given %zu numbers", limit.name,
                curve ? "a multiple of " : "", curve ? std::size_t{2 * MODEL_NM} : limit.size,
                x.size());
            return false;
        }
        if (curve) {
            limits_.torque_speed_points = static_cast<int>(x.size() / (2 * MODEL_NM));
        } else {
            std::replace(x.begin(), x.end(), 0.0, std::numeric_limits<double>::infinity());
        }
        limits_.*limit.member = x.empty() ? nullptr : x.data();
    }
    limits_.tool_speed_max = node->get_parameter("limits.tool_speed_max").as_double();
    limits_.tool_acceleration_max =
        node->get_parameter("limits.tool_acceleration_max").as_double();
    deviation_max_ = node->get_parameter("limits.deviation_max").as_double();
    return true;
}

#endif /* MODEL_LIMITED */
#if MODEL_POSITION
// How the robot takes positions.
bool StreamController::read_interface()
{
    const auto node = get_node();
    const auto logger = node->get_logger();
    const std::string name = node->get_parameter("interpolation").as_string();
    if (name != "hold" && name != "linear" && name != "cubic") {
        RCLCPP_ERROR(logger, "parameter interpolation: given %s, expected hold, linear or cubic",
            name.c_str());
        return false;
    }
    robot_.interpolation = name == "hold"     ? MODEL_INTERPOLATION_HOLD
                           : name == "linear" ? MODEL_INTERPOLATION_LINEAR
                                              : MODEL_INTERPOLATION_CUBIC;
    const int64_t each = node->get_parameter("samples_per_position").as_int();
    const int64_t ahead = node->get_parameter("positions_ahead").as_int();
    robot_.samples_per_position = static_cast<int>(std::clamp<int64_t>(each, 0, 100000));
    if (each < 1 || options_.samples_per_interval % robot_.samples_per_position != 0) {
        RCLCPP_ERROR(logger,
            "parameter samples_per_position: given %lld, expected a divisor of "
            "samples_per_interval, %d",
            static_cast<long long>(each), options_.samples_per_interval);
        return false;
    }
    if (!window_.resize(robot_, static_cast<int>(std::clamp<int64_t>(ahead, -1, 1000)))) {
        RCLCPP_ERROR(logger, "parameter positions_ahead: given %lld, expected 1 to 100",
            static_cast<long long>(ahead));
        return false;
    }
    return true;
}
#endif /* MODEL_POSITION */

controller_interface::CallbackReturn StreamController::on_configure(
    const rclcpp_lifecycle::State &)
{
    const auto logger = get_node()->get_logger();
    if (!read_parameters()) {
        return controller_interface::CallbackReturn::FAILURE;
    }
    const int64_t size = model_stream_work(&options_);
    if (size < 0) {
#if MODEL_POSITION
        RCLCPP_ERROR(logger,
            "parameters period, intervals, samples_per_interval: expected samples %g s apart, as "
            "of the "
            "servo, and a horizon that the stream can have",
            servo_.sample_time);
#else /* MODEL_POSITION */
        RCLCPP_ERROR(logger, "parameters intervals, samples_per_interval, delay: %s",
            model_status_text(MODEL_BAD_ARGUMENT));
#endif /* MODEL_POSITION */
        return controller_interface::CallbackReturn::FAILURE;
    }
    const double rate = get_update_rate();
#if MODEL_POSITION
    const double cycle = robot_.samples_per_position * options_.period /
                         options_.samples_per_interval;
    if (!(std::abs(rate * cycle - 1.0) < 1e-6)) {
        RCLCPP_ERROR(logger,
            "parameters period, samples_per_interval, samples_per_position: given %g s, %d and "
            "%d, which need an update "
            "rate of %g Hz; that of the controller is %g Hz",
            options_.period, options_.samples_per_interval, robot_.samples_per_position,
            1.0 / cycle, rate);
        return controller_interface::CallbackReturn::FAILURE;
    }
#else /* MODEL_POSITION */
    cascade_.sample_time = options_.period / options_.samples_per_interval;
    if (!(std::abs(rate * cascade_.sample_time - 1.0) < 1e-6)) {
        RCLCPP_ERROR(logger,
            "parameters period, samples_per_interval: given %g s and %d, which need an update "
            "rate of %g Hz; that of "
            "the controller is %g Hz",
            options_.period, options_.samples_per_interval, 1.0 / cascade_.sample_time, rate);
        return controller_interface::CallbackReturn::FAILURE;
    }
#endif /* MODEL_POSITION */
    const int64_t queue = get_node()->get_parameter("queue").as_int();
    if (queue < 1) {
        RCLCPP_ERROR(logger, "parameter queue: expected at least 1 sample");
        return controller_interface::CallbackReturn::FAILURE;
    }
#if MODEL_FORCE
    const double wrench_time = get_node()->get_parameter("wrench_time").as_double();
    if (!(wrench_time >= options_.period && std::isfinite(wrench_time))) {
        RCLCPP_ERROR(logger,
            "parameter wrench_time: given %g s, expected %g s or more, an interval of the stream",
            wrench_time, options_.period);
        return controller_interface::CallbackReturn::FAILURE;
    }
    ramp_.set_times(wrench_time, options_.period);
#endif /* MODEL_FORCE */
    memory_.assign(static_cast<std::size_t>(size), 0.0);
    stream_.memory = memory_.data();
    stream_.size = size;
    q_m_.assign(static_cast<std::size_t>(options_.samples_per_interval) * MODEL_NM, 0.0);
    tau_m_.assign(q_m_.size(), 0.0);
#if MODEL_POSITION
    command_m_.assign(q_m_.size(), 0.0);
#endif /* MODEL_POSITION */
    queue_.resize(static_cast<std::size_t>(queue));
    subscription_ = get_node()->create_subscription<std_msgs::msg::Float64MultiArray>(
        "~/reference", rclcpp::SystemDefaultsQoS(),
        [this](const std_msgs::msg::Float64MultiArray::SharedPtr message) {
            if (!enqueue(message->data)) {
                RCLCPP_WARN(get_node()->get_logger(),
                    "reference: given %zu numbers, expected a multiple of %d, and room in the "
                    "queue for %zu samples: "
                    "the message is ignored",
                    message->data.size(), SAMPLE, queue_.room());
            }
        });
#if MODEL_FORCE
    wrenches_.resize(WRENCHES);
    wrench_subscription_ = get_node()->create_subscription<geometry_msgs::msg::WrenchStamped>(
        "~/wrench", rclcpp::SystemDefaultsQoS(),
        [this](const geometry_msgs::msg::WrenchStamped::SharedPtr message) {
            const auto &f = message->wrench.force, &m = message->wrench.torque;
            if (!push_wrench({f.x, f.y, f.z, m.x, m.y, m.z})) {
                RCLCPP_WARN(get_node()->get_logger(),
                    "wrench: expected finite numbers, and zero for what the output does not have: "
                    "the message is "
                    "ignored");
            }
        });
#endif /* MODEL_FORCE */
    return controller_interface::CallbackReturn::SUCCESS;
}

bool StreamController::enqueue(const std::vector<double> &samples)
{
    const std::size_t n = samples.size() / SAMPLE;
    if (n == 0 || samples.size() % SAMPLE != 0 || n > queue_.room() || is_in_chained_mode()) {
        return false;
    }
    for (std::size_t k = 0; k < n; ++k) {
        queue_.push(samples.data() + k * SAMPLE);
    }
    return true;
}

#if MODEL_FORCE
bool StreamController::push_wrench(const std::array<double, 6> &wrench)
{
    std::array<double, MODEL_NY> force{};
    std::array<double, 6> others = wrench;
    for (std::size_t i = 0; i < MODEL_NY; ++i) {
        const auto row = static_cast<std::size_t>(WRENCH_ROWS[i]);
        force[i] = wrench[row];
        others[row] = std::isfinite(wrench[row]) ? 0.0 : NOT_A_NUMBER;
    }
    return std::all_of(others.begin(), others.end(), [](double entry) { return entry == 0.0; }) &&
           wrenches_.push(force.data());
}

// Give the stream the force of the sample that it takes next, that of the topic included.
void StreamController::give_force(const double *sample)
{
    std::array<double, 3 * MODEL_NY> force = pushing_;
    for (std::size_t i = 0; i < force.size(); ++i) {
        force[i] += sample[MODEL_NT + 2 * MODEL_NY + i];
    }
    (void)model_stream_force(&stream_, force.data()); // finite, and the stream runs
}

#endif /* MODEL_FORCE */
controller_interface::InterfaceConfiguration
StreamController::command_interface_configuration() const
{
    controller_interface::InterfaceConfiguration out{
        controller_interface::interface_configuration_type::INDIVIDUAL, {}};
    for (const auto &joint : joints_) {
#if MODEL_POSITION
        out.names.push_back(joint + "/position");
#else /* MODEL_POSITION */
        out.names.push_back(joint + "/effort");
#endif /* MODEL_POSITION */
    }
    return out;
}

controller_interface::InterfaceConfiguration
StreamController::state_interface_configuration() const
{
    controller_interface::InterfaceConfiguration out{
        controller_interface::interface_configuration_type::INDIVIDUAL, {}};
    for (const auto &joint : joints_) {
        out.names.push_back(joint + "/position");
    }
    return out;
}

std::vector<hardware_interface::CommandInterface>
StreamController::on_export_reference_interfaces()
{
    reference_interfaces_.assign(SAMPLE, NOT_A_NUMBER);
    std::vector<hardware_interface::CommandInterface> out;
    out.reserve(SAMPLE);
    for (int i = 0; i < SAMPLE; ++i) {
#if MODEL_FORCE
        const int order = i < MODEL_NT ? 0 : 1 + (i - MODEL_NT) / MODEL_NY;
        const int entry = i < MODEL_NT ? i : (i - MODEL_NT) % MODEL_NY;
        const char *const names[] = {"y_", "dy_", "ddy_", "f_", "df_", "ddf_"};
#else /* MODEL_FORCE */
        const int order = i < MODEL_NT ? 0 : i < MODEL_NT + MODEL_NY ? 1 : 2;
        const int entry = order == 0 ? i : order == 1 ? i - MODEL_NT : i - MODEL_NT - MODEL_NY;
        const char *const names[] = {"y_", "dy_", "ddy_"};
#endif /* MODEL_FORCE */
        out.emplace_back(std::string(get_node()->get_name()) + "/output",
            names[order] + std::to_string(entry),
            &reference_interfaces_[static_cast<std::size_t>(i)]);
    }
    return out;
}

bool StreamController::on_set_chained_mode(bool)
{
    return true;
}

bool StreamController::measure()
{
    for (std::size_t j = 0; j < MODEL_NM; ++j) {
        const auto position = state_interfaces_[j].get_optional();
        if (!position.has_value() || !std::isfinite(*position)) {
            return false;
        }
        measured_[j] = gear_ratio_[j] * *position + offset_[j];
    }
    return true;
}

#if MODEL_POSITION
#else /* MODEL_POSITION */
// The hardware keeps the last effort: without this the motors would go on with it.
bool StreamController::release_motors()
{
    bool written = true;
    for (auto &effort : command_interfaces_) {
        written = effort.set_value(0.0) && written;
    }
    return written;
}

#endif /* MODEL_POSITION */
controller_interface::CallbackReturn StreamController::on_activate(const rclcpp_lifecycle::State &)
{
    const auto logger = get_node()->get_logger();
    if (state_interfaces_.size() != MODEL_NM || command_interfaces_.size() != MODEL_NM ||
        !measure()) {
#if MODEL_POSITION
        RCLCPP_ERROR(logger, "interfaces: expected %d finite positions and %d to command",
            MODEL_NM, MODEL_NM);
#else /* MODEL_POSITION */
        RCLCPP_ERROR(
            logger, "interfaces: expected %d finite positions and %d efforts", MODEL_NM, MODEL_NM);
#endif /* MODEL_POSITION */
        return controller_interface::CallbackReturn::FAILURE;
    }
    std::fill(held_.begin(), held_.end(), 0.0);
    std::copy(start_output_.begin(), start_output_.end(), held_.begin());
    int status = model_stream_start(&stream_, &options_, held_.data(), q_start_.data());
    std::fill(reference_interfaces_.begin(), reference_interfaces_.end(), NOT_A_NUMBER);
    queue_.clear();
#if MODEL_FORCE
    ramp_.reset();
#endif /* MODEL_FORCE */
#if MODEL_LIMITED
    if (status == MODEL_OK) {
        status = model_stream_all_limits(&stream_, &limits_, deviation_max_);
        if (status < 0) {
            RCLCPP_ERROR(logger, "parameters limits: %s",
                model_status_text(static_cast<model_status>(status)));
            return controller_interface::CallbackReturn::FAILURE;
        }
    }
#endif /* MODEL_LIMITED */
    if (status == MODEL_OK) {
        status = begin_interval(); // at rest: where the motors should be
    }
    warnings_ = missing_ = 0;
    if (status < 0) {
        RCLCPP_ERROR(logger, "start of the stream: %s",
            model_status_text(static_cast<model_status>(status)));
        return controller_interface::CallbackReturn::FAILURE;
    }
    Motors q_m{};
    for (std::size_t j = 0; j < MODEL_NM; ++j) {
        q_m[j] = q_m_[j];
        if (!(std::abs(measured_[j] - q_m[j]) <= start_tolerance_)) {
            RCLCPP_ERROR(logger,
                "%s: motor angle %g rad, at the start of the stream %g rad: move the robot there "
                "first",
                joints_[j].c_str(), measured_[j], q_m[j]);
            return controller_interface::CallbackReturn::FAILURE;
        }
    }
#if MODEL_POSITION
    window_.fill(command_m_.data());
#else /* MODEL_POSITION */
    cascade_.reset(measured_, q_m);
#endif /* MODEL_POSITION */
    part_ = 0;
    return controller_interface::CallbackReturn::SUCCESS;
}

controller_interface::CallbackReturn StreamController::on_deactivate(
    const rclcpp_lifecycle::State &)
{
#if MODEL_POSITION
#else /* MODEL_POSITION */
    if (!release_motors()) {
        RCLCPP_ERROR(get_node()->get_logger(), "interfaces: the efforts cannot be set to 0");
    }
#endif /* MODEL_POSITION */
    if (warnings_ + missing_ > 0) {
        RCLCPP_WARN(get_node()->get_logger(),
            "%llu intervals with a warning of the stream, %llu without a new sample",
            static_cast<unsigned long long>(warnings_), static_cast<unsigned long long>(missing_));
    }
    return controller_interface::CallbackReturn::SUCCESS;
}

controller_interface::return_type StreamController::update_reference_from_subscribers(
    const rclcpp::Time &, const rclcpp::Duration &)
{
    if (part_ == 0) {
        queue_.pop(reference_interfaces_.data());
    }
    return controller_interface::return_type::OK;
}

// Take a sample, and compute the interval that begins now.
int StreamController::begin_interval()
{
    model_motion motion{};
    motion.q_m = q_m_.data();
    motion.tau_m = tau_m_.data();
#if MODEL_POSITION
    motion.command_m = command_m_.data();
#endif /* MODEL_POSITION */
    double *const sample = reference_interfaces_.data();
    int status = MODEL_BAD_ARGUMENT;
#if MODEL_FORCE
    std::array<double, MODEL_NY> wrench{};
    for (std::size_t k = 0; k < WRENCHES && wrenches_.pop(wrench.data()); ++k) {
        ramp_.set_next(wrench);
    }
    pushing_ = ramp_.step();
#endif /* MODEL_FORCE */
    if (finite(reference_interfaces_) && reference_interfaces_.size() == SAMPLE) {
#if MODEL_FORCE
        give_force(sample);
#endif /* MODEL_FORCE */
        status = model_stream_update(
            &stream_, sample, sample + MODEL_NT, sample + MODEL_NT + MODEL_NY, &motion, &info_);
        if (!refused(status)) {
            std::copy(sample, sample + MODEL_NT, held_.begin());
#if MODEL_FORCE
            std::copy_n(sample + MODEL_NT + 2 * MODEL_NY, MODEL_NY,
                held_.begin() + MODEL_NT + 2 * MODEL_NY);
#endif /* MODEL_FORCE */
        }
    }
    if (refused(status)) {
        ++missing_;
#if MODEL_FORCE
        give_force(held_.data());
#endif /* MODEL_FORCE */
        status = model_stream_update(&stream_, held_.data(), held_.data() + MODEL_NT,
            held_.data() + MODEL_NT + MODEL_NY, &motion, &info_);
    }
    std::fill(reference_interfaces_.begin(), reference_interfaces_.end(), NOT_A_NUMBER);
    warnings_ += status > 0;
    return status;
}

controller_interface::return_type StreamController::update_and_write_commands(
    const rclcpp::Time &, const rclcpp::Duration &)
{
#if MODEL_POSITION
    Motors position{};
    if ((part_ == 0 && begin_interval() < 0) ||
        !window_.step(
            command_m_.data() + static_cast<std::ptrdiff_t>(part_) * MODEL_NM, position)) {
        return controller_interface::return_type::ERROR;
    }
    bool written = true;
    for (std::size_t j = 0; j < MODEL_NM; ++j) {
        written = command_interfaces_[j].set_value((position[j] - offset_[j]) / gear_ratio_[j]) &&
                  written;
    }
    part_ = (part_ + robot_.samples_per_position) % options_.samples_per_interval;
    return written ? controller_interface::return_type::OK :
                     controller_interface::return_type::ERROR;
#else /* MODEL_POSITION */
    if (!measure() || (part_ == 0 && begin_interval() < 0)) {
        release_motors();
        return controller_interface::return_type::ERROR;
    }
    Motors q_ref{}, tau_ff{};
    const std::size_t at = static_cast<std::size_t>(part_) * MODEL_NM;
    std::copy_n(q_m_.begin() + static_cast<std::ptrdiff_t>(at), MODEL_NM, q_ref.begin());
    std::copy_n(tau_m_.begin() + static_cast<std::ptrdiff_t>(at), MODEL_NM, tau_ff.begin());
    const Motors tau = cascade_.step(measured_, q_ref, tau_ff);
    bool written = true;
    for (std::size_t j = 0; j < MODEL_NM; ++j) {
        written = command_interfaces_[j].set_value(gear_ratio_[j] * tau[j]) && written;
    }
    if (!written) {
        release_motors();
        return controller_interface::return_type::ERROR;
    }
    part_ = (part_ + 1) % options_.samples_per_interval;
    return controller_interface::return_type::OK;
#endif /* MODEL_POSITION */
}

} // namespace flexgen_space

PLUGINLIB_EXPORT_CLASS(
    flexgen_space::StreamController, controller_interface::ChainableControllerInterface)
