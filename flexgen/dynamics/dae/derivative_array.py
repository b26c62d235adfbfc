"""The derivative array of the inverse dynamics as CasADi functions of fixed order, which solvers
integrate.

    F_mu(X, U) = (F, dF/dt, ..., d^mu F/dt^mu),      X = (x, x', ..., x^(mu+1)),
    U = (u, u', ..., u^(mu))

With ``E = dF/dx'`` and ``A = dF/dx`` its Jacobian is

    d F^(i) / d x^(j) = C(i, j) A^(i-j) + C(i, j-1) E^(i-j+1)              C: binomial coefficients

so that only E and A have to be differentiated in time. F: see `flexgen.dynamics.dae.system`.
`flexgen.dynamics.dae.taylor_array` has the same array by Taylor series; the tests compare both.

Source: P. Kunkel, V. Mehrmann, Differential-Algebraic Equations, 2006, ch. 3 and 4.
"""

from __future__ import annotations

from functools import cached_property
from math import comb

import casadi as ca

from flexgen.dynamics.dae.system import InverseDae


class DerivativeArray:
    """The derivative array of order ``mu`` of a DAE; functions are built when they are first
    used.
    """

    def __init__(self, dae: InverseDae, mu: int) -> None:
        self.dae = dae
        self.mu = mu

    @cached_property
    def function(self) -> ca.Function:
        """(X, U) -> F_mu, N, M.

        ``X`` (n_x, mu + 2): x and its derivatives by columns; ``U`` (n_u, mu + 1); ``F_mu``
        ((mu + 1) m); ``N`` = dF_mu/dx ((mu + 1) m, n_x); ``M`` = dF_mu/d(x', ..., x^(mu+1))
        ((mu + 1) m, (mu + 1) n_x).
        """
        dae = self.dae
        mu = self.mu
        x, dx, u, rows = dae.graph
        X = [x, dx, *(ca.SX.sym(f"x{k}", dae.n_x) for k in range(2, mu + 2))]
        U = [u, *(ca.SX.sym(f"u{k}", dae.n_u) for k in range(1, mu + 1))]

        def rate(g: ca.SX, k: int) -> ca.SX:  # g depends on X[:k+2], U[:k+1]
            moving = ca.vertcat(*X[: k + 2], *U[: k + 1])
            rates = ca.vertcat(*X[1 : k + 3], *U[1 : k + 2])
            return ca.reshape(ca.jtimes(ca.vec(g), moving, rates), g.shape)

        F = [rows]
        A = [ca.jacobian(rows, x)]
        E = [ca.jacobian(rows, dx)]
        for k in range(mu):
            F.append(rate(F[-1], k))
            A.append(rate(A[-1], k))
            E.append(rate(E[-1], k))
        blocks = [
            [
                (comb(i, j) * A[i - j] if j <= i else 0)
                + (comb(i, j - 1) * E[i - j + 1] if j else 0)
                if j <= i + 1
                else ca.SX(dae.m, dae.n_x)
                for j in range(mu + 2)
            ]
            for i in range(mu + 1)
        ]
        N = ca.vertcat(*[row[0] for row in blocks])
        M = ca.vertcat(*[ca.horzcat(*row[1:]) for row in blocks])
        return ca.Function(
            f"array{mu}",
            [ca.horzcat(*X), ca.horzcat(*U)],
            [ca.densify(z) for z in (ca.vertcat(*F), N, M)],
            ["X", "U"],
            ["F", "N", "M"],
        )

    @cached_property
    def rows(self) -> ca.Function:
        """The derivative array alone: (X, U) -> F_mu."""
        X = ca.SX.sym("X", self.dae.n_x, self.mu + 2)
        U = ca.SX.sym("U", self.dae.n_u, self.mu + 1)
        return ca.Function(
            f"array_rows{self.mu}", [X, U], [self.function(X, U)[0]], ["X", "U"], ["F"]
        )
