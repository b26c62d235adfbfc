// Pinocchio's side of the comparison: one model, one quantity, a set of states to cycle through.
//
// Everything is compiled here from Pinocchio's headers: without
// PINOCCHIO_ENABLE_TEMPLATE_INSTANTIATION no algorithm comes out of the library that its package
// ships. The model is read from a text file that peers_robots.py writes. Compiled twice, so that
// two cores share the work: with -DDERIVATIVES the derivatives, without it the rest.

#include "peers_model.hpp"
#ifdef DERIVATIVES
#include <pinocchio/algorithm/aba-derivatives.hpp>
#include <pinocchio/algorithm/rnea-derivatives.hpp>
#else
#include <pinocchio/algorithm/aba.hpp>
#include <pinocchio/algorithm/crba.hpp>
#include <pinocchio/algorithm/rnea.hpp>
#endif

#include <string>
#include <vector>

using Vector = Eigen::VectorXd;
using Matrix = Eigen::MatrixXd;

namespace {

struct State {
    Vector q, v, x; // x: accelerations or torques
};

struct Peer {
    pin::Model model;
    pin::Data data;
    std::vector<State> states;
    explicit Peer(const char *path) : model(read(path)), data(model) {}
    virtual ~Peer() = default;
    virtual void run(long calls) = 0;
    virtual std::vector<Matrix> results(std::size_t state) = 0;
};

// A quantity is `evaluate`, which is timed, and `results`, which reads the results out for the
// comparison before.
template <class Quantity> struct Timed final : Peer {
    using Peer::Peer;
    void run(long calls) override
    {
        std::size_t k = 0;
        for (long i = 0; i < calls; ++i) {
            Quantity::evaluate(model, data, states[k]);
            asm volatile(""
                :
                : "r"(&data)
                : "memory"); // the results are used, as far as the compiler can know
            k = k + 1 == states.size() ? 0 : k + 1;
        }
    }
    std::vector<Matrix> results(std::size_t state) override
    {
        Quantity::evaluate(model, data, states[state]);
        return Quantity::results(data);
    }
};

using Parts = std::vector<Matrix>;

Matrix full(const Matrix &upper) // Pinocchio writes the upper half of what is symmetric
{
    return upper.selfadjointView<Eigen::Upper>();
}

#ifdef DERIVATIVES

struct InverseDynamicsDerivatives {
    static void evaluate(const pin::Model &m, pin::Data &d, const State &s)
    {
        pin::computeRNEADerivatives(m, d, s.q, s.v, s.x);
    }
    static Parts results(const pin::Data &d) { return {d.dtau_dq, d.dtau_dv, full(d.M)}; }
};

struct ForwardDynamicsDerivatives {
    static void evaluate(const pin::Model &m, pin::Data &d, const State &s)
    {
        pin::computeABADerivatives(m, d, s.q, s.v, s.x);
    }
    static Parts results(const pin::Data &d) { return {d.ddq_dq, d.ddq_dv, full(d.Minv)}; }
};

Peer *make(const std::string &quantity, const char *path)
{
    if (quantity == "inverse_dynamics_derivatives") {
        return new Timed<InverseDynamicsDerivatives>(path);
    }
    return quantity == "arm_forward_dynamics_derivatives" ?
               new Timed<ForwardDynamicsDerivatives>(path) :
               nullptr;
}

#else

struct InverseDynamics {
    static void evaluate(const pin::Model &m, pin::Data &d, const State &s)
    {
        pin::rnea(m, d, s.q, s.v, s.x);
    }
    static Parts results(const pin::Data &d) { return {d.tau}; }
};

template <pin::Convention C> struct MassMatrix {
    static void evaluate(const pin::Model &m, pin::Data &d, const State &s)
    {
        pin::crba(m, d, s.q, C);
    }
    static Parts results(const pin::Data &d) { return {full(d.M)}; }
};

template <pin::Convention C> struct ForwardDynamics {
    static void evaluate(const pin::Model &m, pin::Data &d, const State &s)
    {
        pin::aba(m, d, s.q, s.v, s.x, C);
    }
    static Parts results(const pin::Data &d) { return {d.ddq}; }
};

Peer *make(const std::string &quantity, const char *path)
{
    constexpr auto local = pin::Convention::LOCAL, world = pin::Convention::WORLD;
    if (quantity == "inverse_dynamics") {
        return new Timed<InverseDynamics>(path);
    }
    if (quantity == "mass_matrix:local") {
        return new Timed<MassMatrix<local>>(path);
    }
    if (quantity == "mass_matrix:world") {
        return new Timed<MassMatrix<world>>(path);
    }
    if (quantity == "arm_forward_dynamics:local") {
        return new Timed<ForwardDynamics<local>>(path);
    }
    return quantity == "arm_forward_dynamics:world" ? new Timed<ForwardDynamics<world>>(path) :
                                                      nullptr;
}

#endif

} // namespace

extern "C" void *peer_open(
    const char *quantity, const char *path, const double *states, int count, int size)
{
    Peer *peer = make(quantity, path);
    if (peer == nullptr) {
        return nullptr;
    }
    const int n = peer->model.nv, parts = size / n;
    for (int k = 0; k < count; ++k) {
        const auto part = [&](int i) -> Vector {
            return i < parts ? Vector(Eigen::Map<const Vector>(states + k * size + i * n, n)) :
                               Vector(Vector::Zero(n));
        };
        peer->states.push_back({part(0), part(1), part(2)});
    }
    return peer;
}

extern "C" void peer_run(void *peer, long calls)
{
    static_cast<Peer *>(peer)->run(calls);
}

extern "C" void peer_result(void *peer, int state, double *out)
{
    for (const Matrix &part :
        static_cast<Peer *>(peer)->results(static_cast<std::size_t>(state))) {
        out = std::copy(part.data(), part.data() + part.size(), out);
    }
}
