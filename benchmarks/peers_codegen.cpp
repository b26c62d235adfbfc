// Pinocchio's code generation: its algorithms on CasADi's symbols, saved as functions that CasADi
// writes as C.

#include <casadi/casadi.hpp>
#include <pinocchio/autodiff/casadi.hpp>

#include "peers_model.hpp"

#include <pinocchio/algorithm/aba-derivatives.hpp>
#include <pinocchio/algorithm/aba.hpp>
#include <pinocchio/algorithm/crba.hpp>
#include <pinocchio/algorithm/rnea-derivatives.hpp>
#include <pinocchio/algorithm/rnea.hpp>

namespace {

using Symbol = casadi::SX;
using Vector = Eigen::Matrix<Symbol, Eigen::Dynamic, 1>;

template <class Matrix> Symbol sparse(const Matrix &matrix, bool mirrored)
{
    Symbol out(matrix.rows(), matrix.cols());
    for (Eigen::Index i = 0; i < matrix.rows(); ++i) {
        for (Eigen::Index j = 0; j < matrix.cols();
            ++j) { // Pinocchio writes the upper half of what is symmetric
            out(i, j) = mirrored && j < i ? matrix(j, i) : matrix(i, j);
        }
    }
    return out;
}

casadi::Function made(const std::string &quantity, const char *path)
{
    const auto model = read(path).cast<Symbol>();
    pin::DataTpl<Symbol> data(model);
    const int n = model.nv;
    const Symbol q = Symbol::sym("q", n), v = Symbol::sym("v", n), x = Symbol::sym("x", n);
    Vector q_(n), v_(n), x_(n);
    pin::casadi::copy(q, q_);
    pin::casadi::copy(v, v_);
    pin::casadi::copy(x, x_);
    const auto convention = quantity.find(":world") == std::string::npos ? pin::Convention::LOCAL :
                                                                           pin::Convention::WORLD;
    std::vector<Symbol> given = {q, v, x}, results;
    if (quantity == "inverse_dynamics") {
        results = {sparse(pin::rnea(model, data, q_, v_, x_), false)};
    } else if (quantity.rfind("mass_matrix", 0) == 0) {
        given = {q};
        results = {sparse(pin::crba(model, data, q_, convention), true)};
    } else if (quantity == "inverse_dynamics_derivatives") {
        pin::computeRNEADerivatives(model, data, q_, v_, x_);
        results = {sparse(data.dtau_dq, false), sparse(data.dtau_dv, false), sparse(data.M, true)};
    } else if (quantity == "arm_forward_dynamics_derivatives") {
        pin::computeABADerivatives(model, data, q_, v_, x_);
        results = {
            sparse(data.ddq_dq, false), sparse(data.ddq_dv, false), sparse(data.Minv, true)};
    } else {
        results = {sparse(pin::aba(model, data, q_, v_, x_, convention), false)};
    }
    for (Symbol &result : results) {
        result = densify(result);
    }
    return casadi::Function("generated", given, results);
}

} // namespace

extern "C" int peer_generate(const char *quantity, const char *path, const char *out)
{
    try {
        made(quantity, path).save(out);
        return 0;
    } catch (...) {
        return 1;
    }
}
