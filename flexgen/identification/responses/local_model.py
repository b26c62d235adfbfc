"""The linear model of a robot at rest as a function of its parameters: frequency responses with
exact derivatives.

    Z(w) X = B,    Z = -w^2 M + j w D + K,    G(w) = -w^2 h(w) exp(-j w t_d) C_m X k_t
    [rad/s^2 / (N m)]

from motor torques to motor accelerations, motor side (sensors: see
`flexgen.identification.responses.response_outputs`; hold h, delay t_d, constants k_t, and the
images of sampled motions, which G has too: `flexgen.identification.responses.response_inputs`).
The robot rests at the motor angles of the pose:

    r(y, p, tau_m) = 0,  C_m y = q_m0          (the motors' torques tau_m hold the pose)
    dG/dp = w^2 h exp(-j w t_d) C_m Z^-1 (dZ/dp + sum_i dZ/dy_i dy_i/dp) X k_t
    (without those of images)

Friction laws have no slope at rest that describes their motion. Where the speed of the motors is
known, each law is replaced by the viscous friction of the same mean power, ``E[f(w) w] / E[w^2]``,
w Gaussian (statistical linearization). Springs that are not linear are replaced in the same way:
the torque ``E[tau(d + s)]`` at the mean deflection d, for a Gaussian deflection s about it, in the
equations of rest and in the stiffness.

Source: E. Wernholt and S. Moberg, IFAC 2008 (gray-box identification of robots from frequency
responses); A. Gelb and W. Vander Velde, Multiple-Input Describing Functions, 1968 (statistical
linearization).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from flexgen.analysis.second_order import motor_rows
from flexgen.base.errors import SolverError
from flexgen.base.numerics.evaluate import Evaluator, evaluate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.force_laws import spring_torque
from flexgen.dynamics.mechanics.lagrangian import gears
from flexgen.identification.responses.response_inputs import Drive
from flexgen.identification.responses.response_outputs import OutputRows
from flexgen.identification.rigid.mean_friction import is_linear, mean_viscous_change, normal_nodes
from flexgen.identification.rigid.missing_springs import with_spring
from flexgen.model.elements import LinearSpring, RobotModel, Spring

NEWTON_STEPS = 50
# Hz: of a new spring and the inertia that it carries, where its search begins
FREQUENCIES = (12.0, 35.0, 90.0, 250.0)
DAMPING = 0.03  # of critical
NEAR = 4  # images with springs, two on each side; later ones together have 2 % of what all add


@dataclass(frozen=True)
class Rest:
    """Poses at rest: coordinates ``y`` (k, n), holding torques ``tau_m`` (k, n_m), derivatives
    dy/dp (k, n, n_p).
    """

    y: np.ndarray
    tau_m: np.ndarray
    dy: np.ndarray


@dataclass(frozen=True)
class Response:
    """Frequency responses ``G`` (k, lines, outputs, n_m) and derivatives ``dG`` (..., n_p), or
    None.
    """

    G: np.ndarray
    dG: np.ndarray | None


class LocalModel:
    """Linear models of one robot at rest, for any pose and any values of its parameters.

    Parameters
    ----------
    model : RobotModel
    parameters : sequence of str
        Names of the numbers that may change; see `flexgen.dynamics.mechanics.parameters`.
    sensors : sequence of str
        Names of sensor channels that are outputs too, after the motors.

    Attributes
    ----------
    names : tuple of str
        Of the parameters, in the order of their values.
    values : array (n_p,)
        Those of the model.
    """

    def __init__(
        self, model: RobotModel, parameters: Sequence[str], sensors: Sequence[str] = ()
    ) -> None:
        self.equations = Equations(model, parameters)
        self.model = model
        self.names = tuple(parameter.name for parameter in self.equations.parameters)
        self.values = np.array([parameter.value for parameter in self.equations.parameters])
        self.motor_rows = motor_rows(model)
        self.outputs = OutputRows(self.equations, self.motor_rows, sensors)

    @cached_property
    def rate(self) -> ca.Function:
        """Rate of the state ``(y, y')`` under motor torques, a function of state, torques and
        parameters.
        """
        sizes = {"x": 2 * self.model.dof, "u": self.model.n_m, "p": len(self.names)}
        x, u, p = (ca.SX.sym(name, n) for name, n in sizes.items())
        function = self.equations.function("state_rate")
        rate = function(x, u, p) if function.n_in() == 3 else function(x, u)
        return ca.Function("segment_rate", [x, u, p], [ca.cse(rate)])

    @cached_property
    def springs(self) -> tuple[tuple[Spring, np.ndarray], ...]:
        """Springs whose spread of deflections counts, with symbols as parameters, and their rows
        s: deflections s y.

        Those that are not linear, and those of all gears where friction depends on their torques.
        """
        model = self.equations.with_symbols
        C = self.motor_rows
        loaded = any(motor.friction.loaded for motor in self.model.motors)
        theta = np.linalg.inv(model.eta) @ C
        out = []
        factors = iter(zip(gears(model), theta, strict=True))
        for i, coordinate in enumerate(model.coordinates):
            dof = coordinate.dof
            row = np.zeros(model.dof)
            row[i] = 1.0
            spring = None if dof is None else dof.spring
            if dof is not None and dof.gear is not None:
                (gear, ratio), turned = next(factors)
                spring = gear.spring
                row = ratio * (turned - row)
            of_load = loaded and dof is not None and dof.gear is not None
            if spring is not None and (of_load or not isinstance(spring, LinearSpring)):
                out.append((spring, row))
        return tuple(out)

    @cached_property
    def deflection_rows(self) -> np.ndarray:
        """Rows of the deflections of `springs`, (springs, n)."""
        return np.array([row for _, row in self.springs]).reshape(-1, self.model.dof)

    def _average(self, residual: ca.SX, sd: ca.SX) -> ca.SX:
        """The residual with the mean torques of springs that are not linear; ``sd``: of their
        deflections.
        """
        y = self.equations.y[0]
        for k, (spring, row) in enumerate(self.springs):
            d = ca.mtimes(ca.SX(ca.DM(row)).T, y)
            change = sum(
                weight * (spring_torque(spring, d + sd[k] * node) - spring_torque(spring, d))
                for node, weight in zip(*normal_nodes(), strict=True)
            )
            residual = residual + ca.SX(ca.DM(row)) * change
        return residual

    @cached_property
    def _static(self) -> ca.Function:
        """(y, p, tau_m, sd of deflections) -> residual at rest, and its derivatives in y, p and
        tau_m.
        """
        e = self.equations
        y, dy, ddy = e.y
        sd = ca.SX.sym("sd", len(self.springs))
        r = ca.substitute(e.residual, ca.vertcat(dy, ddy), ca.SX.zeros(2 * dy.numel()))
        r = self._average(r, sd)
        p = e.symbols
        tau = e.lagrangian.tau_m
        derivatives = [ca.densify(ca.jacobian(r, x)) for x in (y, p, tau)]
        return ca.Function("rest", [y, p, tau, sd], [ca.densify(r), *derivatives])

    def rest(
        self, values: np.ndarray, q_m: np.ndarray, deflection_sd: np.ndarray | None = None
    ) -> Rest:
        """The robot at rest at the motor angles ``q_m`` (k, n_m), from a search that begins
        without deflections.

        ``deflection_sd`` (k, springs): standard deviations of the deflections of `springs`, for
        their mean torques.

        Raises
        ------
        SolverError
            No equilibrium is found.
        """
        model = self.model
        C = self.motor_rows
        n = model.dof
        m = model.n_m
        spread = self._deflections(deflection_sd, len(q_m))
        out = []
        static = Evaluator(self._static)
        for k, angles in enumerate(q_m):
            y = np.zeros(n)
            y[list(model.i_g)] = np.linalg.solve(model.eta, angles)
            y[model.n_a :] = angles[list(model.i_m)]
            tau = np.zeros(m)
            best = np.inf
            stalled = 0
            for _ in range(NEWTON_STEPS):
                r, r_y, r_p, r_tau = static(y, values, tau, spread[k])
                A = np.block([[r_y, r_tau], [C, np.zeros((m, m))]])
                right = np.concatenate([r[:, 0], C @ y - angles])
                scale = np.maximum(np.abs(A).max(axis=1), 1e-12)
                error = float(np.abs(right / scale).max())
                stalled = stalled + 1 if error >= 0.5 * best else 0
                best = min(best, error)
                if error < 1e-15 or (stalled > 2 and best < 1e-12):
                    break
                try:
                    step = np.linalg.solve(A / scale[:, None], right / scale)
                except np.linalg.LinAlgError:
                    best = np.inf
                    break
                y = y - step[:n]
                tau = tau - step[n:]
            if not best < 1e-9:
                raise SolverError(
                    f"equilibrium at pose {k + 1} (q_m = {np.round(angles, 4).tolist()} rad): "
                    f"not found, residual {best:.1e}, expected below 1e-9; choose another pose, "
                    "or parameters nearer to those of the model"
                )
            by_p = np.linalg.solve(
                A / scale[:, None], np.vstack([-r_p, np.zeros((m, r_p.shape[1]))]) / scale[:, None]
            )
            out.append((y, tau, by_p[:n]))
        return Rest(*(np.array(x) for x in zip(*out, strict=True)))

    @cached_property
    def _matrices(
        self,
    ) -> tuple[ca.Function, ca.Function, dict[str, tuple[np.ndarray, np.ndarray]]]:
        """(y, p, deviations) -> M, D, K, B; the nonzero derivatives of M, D, K in p and y; where
        these stand.

        Deviations: of the speeds of motors and coordinates, then of the deflections of `springs`.
        """
        e = self.equations
        y, dy, ddy = e.y
        p = e.symbols
        tau = e.lagrangian.tau_m
        still = ca.vertcat(dy, ddy, tau)
        speeds = self.model.n_m + self.model.n_a
        deviations = ca.SX.sym("deviations", speeds + len(self.springs))
        r = self._average(e.residual, deviations[speeds:])
        jacobians = [ca.jacobian(r, x) for x in (ddy, dy, y, tau)]
        M, D, K, B = (
            ca.densify(ca.substitute(x, still, ca.SX.zeros(still.numel()))) for x in jacobians
        )
        D = D + ca.substitute(
            self._friction(deviations[:speeds], deviations[speeds:]), still, 0 * still
        )
        stacked = ca.vertcat(ca.vec(M), ca.vec(D), ca.vec(K))
        places = {}
        derivatives = []
        for name, x in (("p", p), ("y", y)):
            J = ca.jacobian(stacked, x)
            rows, columns = (np.array(index, dtype=int) for index in J.sparsity().get_triplet())
            places[name] = (rows, columns)
            derivatives.append(J[:].nz[:] if J.nnz() else ca.SX(0, 1))
        inputs = [y, p, deviations]
        return (
            ca.Function("matrices", inputs, [M, D, K, -B]),
            ca.Function("derivatives", inputs, [ca.vertcat(*[ca.vec(x) for x in derivatives])]),
            places,
        )

    def _friction(self, speed_sd: ca.SX, deflection_sd: ca.SX) -> ca.SX:
        """Mean slope of all friction laws less the slope at rest, as a matrix (n, n)."""
        model = self.equations.with_symbols
        C = self.motor_rows
        D = ca.SX.zeros(model.dof, model.dof)
        loads = self.equations.lagrangian.tau_gm
        by_deflection = ca.mtimes(
            ca.jacobian(loads, self.equations.y[0]), ca.DM(np.linalg.pinv(self.deflection_rows))
        )
        # (the root has no derivative at 0)
        spread = ca.sqrt(ca.mtimes(by_deflection**2, deflection_sd**2) + 1e-30)
        laws: list[Any] = [
            (m.friction, C[j], (speed_sd[j], loads[j], spread[j]))
            for j, m in enumerate(model.motors)
        ]
        for i, coordinate in enumerate(model.coordinates):
            if coordinate.dof is not None:
                laws.append(
                    (
                        coordinate.dof.friction,
                        np.eye(model.dof)[i],
                        (speed_sd[model.n_m + i], None, None),
                    )
                )
        for friction, row, (sd, *load) in laws:
            if not is_linear(friction):
                change = mean_viscous_change(friction, sd, model.temperature, *load)
                D += change * ca.SX(ca.DM(np.outer(row, row)))
        return D

    def matrices(
        self,
        values: np.ndarray,
        q_m: np.ndarray,
        speed_sd: np.ndarray | None = None,
        deflection_sd: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """``M, D, K`` (k, n, n) and ``B`` (k, n, n_m) of the linear models at the poses ``q_m``
        (k, n_m).
        """
        rest = self.rest(values, q_m, deflection_sd)
        spread = np.hstack(
            [self._speeds(speed_sd, len(q_m)), self._deflections(deflection_sd, len(q_m))]
        )
        M, D, K, B = evaluate(self._matrices[0], rest.y, values, spread)
        n = self.model.dof
        return (
            M.reshape(-1, n, n),
            D.reshape(-1, n, n),
            K.reshape(-1, n, n),
            B.reshape(-1, n, self.model.n_m),
        )

    def _speeds(self, speed_sd: np.ndarray | None, count: int) -> np.ndarray:
        """Deviations of the speeds of motors and, from those, of the coordinates (k, n_m + n_a);
        zero: at rest.
        """
        model = self.model
        motors = (
            np.zeros((count, model.n_m))
            if speed_sd is None
            else np.broadcast_to(speed_sd, (count, model.n_m))
        )
        arm = np.zeros((count, model.n_a))
        arm[:, list(model.i_g)] = np.sqrt((motors**2) @ (np.linalg.inv(model.eta).T ** 2))
        return np.hstack([motors, arm])

    def _deflections(self, deflection_sd: np.ndarray | None, count: int) -> np.ndarray:
        """Deviations of the deflections of `springs` (k, springs); zero: at rest."""
        shape = (count, len(self.springs))
        return np.zeros(shape) if deflection_sd is None else np.broadcast_to(deflection_sd, shape)

    def deflection_sd(
        self,
        values: np.ndarray,
        q_m: np.ndarray,
        w: np.ndarray,
        drive: Drive,
        UU: np.ndarray,
        speed_sd: np.ndarray | None = None,
        start: np.ndarray | None = None,
    ) -> np.ndarray:
        """Standard deviations of the deflections of `springs` (k, springs) under torques with the
        spectra of the data.

        ``UU`` (k, lines, n_m, n_m): mean of ``U U^H`` over the experiments, U amplitudes;
        ``start``: deviations about which the springs are averaged meanwhile.
        """
        M, D, K, B = self.matrices(values, q_m, speed_sd, start)
        s = 1j * w[:, None, None]
        out = np.zeros((len(q_m), len(self.springs)))
        for k in range(len(q_m)):
            X = self.deflection_rows @ np.linalg.solve(s**2 * M[k] + s * D[k] + K[k], B[k] + 0j)
            X = X * drive.transfer(w, self.model.n_m)[:, None, :]
            out[k] = np.sqrt(np.real(np.einsum("lai,lij,laj->a", X, UU[k], X.conj())) / 2)
        return out

    def response(
        self,
        values: np.ndarray,
        q_m: np.ndarray,
        w: np.ndarray,
        drive: Drive,
        *,
        speed_sd: np.ndarray | None = None,
        deflection_sd: np.ndarray | None = None,
        derivatives: bool = True,
        rest: Rest | None = None,
    ) -> Response:
        """Frequency responses from motor torques to the accelerations of motors and the signals of
        sensors.

        Parameters
        ----------
        values : array (n_p,)
        q_m : array (k, n_m) [rad]
            Motor angles of the poses, motor side.
        w : array (lines,) [rad/s]
        drive : Drive
        speed_sd : array (k, n_m) or (n_m,), optional [rad/s]
            Standard deviation of the speed of each motor, motor side; for friction that is not
            viscous.
        deflection_sd : array (k, springs), optional [rad or m]
            Standard deviation of the deflection of each spring of `springs`.
        derivatives : bool
            Also the derivatives in the parameters.
        rest : Rest, optional
            The poses at rest, where they are known.
        """
        rest = self.rest(values, q_m, deflection_sd) if rest is None else rest
        speeds = np.hstack(
            [self._speeds(speed_sd, len(q_m)), self._deflections(deflection_sd, len(q_m))]
        )
        function, by, _ = self._matrices
        n = self.model.dof
        M, D, K, B = (
            x.reshape(len(q_m), n, -1) for x in evaluate(function, rest.y, values, speeds)
        )
        inward = drive.transfer(w, self.model.n_m)[:, None, :]
        outward = self.outputs.transfer(w, drive.sensor_delays)[:, :, None]
        rows, drows = self.outputs.at(
            rest.y, rest.dy, values, speeds[:, self.model.n_m :][:, : self.model.n_a]
        )
        near, far = self._images(w, drive)
        s = 1j * w[:, None, None]
        G = []
        dG = []
        changes = evaluate(by, rest.y, values, speeds)[0] if derivatives else None
        for k in range(len(q_m)):
            Z = s**2 * M[k] + s * D[k] + K[k]
            C = outward * (s**2 * rows[k, 0] + s * rows[k, 1] + rows[k, 2])
            both = np.linalg.inv(Z)
            X = both @ B[k] * inward
            r, after, before = near
            turned = np.linalg.solve(r**2 * M[k] + r * D[k] + K[k], B[k] + 0j)
            images = (
                after * ((r**2 * rows[k, 0] + r * rows[k, 1] + rows[k, 2]) @ turned) * before
            ).sum(axis=0)
            free = rows[k] @ np.linalg.solve(M[k], B[k])
            G.append(C @ X + images + (far * free[:, None]).sum(axis=0))
            if changes is None:
                continue
            dG.append(self._derivative(changes[k], rest.dy[k], C @ both, -X, w))
            if drows[k].any():  # the rows of sensors depend on the pose of rest, and on masses
                moved = np.einsum("ml,monp->lonp", np.stack([s**2, s, s**0])[..., 0, 0], drows[k])
                dG[-1] += outward[..., None] * np.einsum("lonp,lnb->lobp", moved, X, optimize=True)
        return Response(np.array(G), np.array(dG) if derivatives else None)

    def _images(
        self, w: np.ndarray, drive: Drive
    ) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
        """Images with springs: s (images, lines, 1, 1), and factors of the outputs and inputs
        (images, lines, ., .).

        And the sums of all others, of the powers 0, -1 and -2 of s, (3, lines, outputs, n_m).
        """
        images = w + drive.images()[:, None]
        s = 1j * images
        after = self.outputs.transfer(images.ravel(), drive.sensor_delays).reshape(
            *s.shape, len(self.outputs)
        )
        after = after * (w / images)[..., None] ** self.outputs.orders
        before = drive.transfer(images.ravel(), self.model.n_m).reshape(*s.shape, self.model.n_m)
        powers = s ** -np.arange(3.0)[:, None, None]
        far = np.einsum("jil,ilo,ilm->jlom", powers[:, NEAR:], after[NEAR:], before[NEAR:])
        return (s[:NEAR, :, None, None], after[:NEAR, :, :, None], before[:NEAR, :, None, :]), far

    def _derivative(
        self,
        changes: np.ndarray,
        dy: np.ndarray,
        left: np.ndarray,
        right: np.ndarray,
        w: np.ndarray,
    ) -> np.ndarray:
        """``left dZ/dp right`` (lines, outputs, n_m, n_p) for all parameters p at one pose."""
        places = self._matrices[2]
        n = self.model.dof
        n_p = len(self.names)
        factors = np.stack([-(w**2), 1j * w, np.ones_like(w)])  # of M, D, K
        out = np.zeros((len(w), left.shape[1], right.shape[2], n_p), complex)
        rows, columns = places["p"]
        for e in range(len(rows)):  # an entry of M, D or K: a product of a column and a row
            kind, entry = divmod(rows[e], n * n)
            column, row = divmod(entry, n)
            if changes[e] != 0.0:
                outer = left[:, :, row, None] * right[:, None, column, :]
                out[:, :, :, columns[e]] += (changes[e] * factors[kind])[:, None, None] * outer
        # The pose moves with p: all of Z changes along dy/dp.
        moved, at = places["y"]
        if len(moved) == 0:
            return out
        used = np.flatnonzero(np.abs(dy).max(axis=1) > 0)
        whole = np.zeros((3 * n * n, n))
        whole[moved, at] = changes[len(rows) :]
        # kind, row, column, direction
        along = whole[:, used].reshape(3, n, n, len(used)).transpose(0, 2, 1, 3)
        flat = along.reshape(3, n, n * len(used))
        change = np.zeros((len(w), n, n * len(used)), complex)
        for kind in range(3):
            if np.any(flat[kind]):
                change += factors[kind][:, None, None] * flat[kind]
        # left (outputs, n) change (n, n directions) right (n, n_m)
        half = (left @ change).reshape(len(w), left.shape[1], n, len(used))
        directions = np.einsum("lacd,lcb->labd", half, right, optimize=True)
        return out + directions @ dy[used]


def with_sizes(model: RobotModel, new: str, pose: np.ndarray) -> list[RobotModel]:
    """The model with a new spring of several stiffnesses, by the inertia that it carries at a pose
    (1, n_m).
    """
    local = LocalModel(with_spring(model, new, 1e12, 1e6), ())
    M = local.matrices(local.values, pose)[0][0]
    at = [c.name for c in model.coordinates].index(new)
    out = []
    for w in 2 * np.pi * np.array(FREQUENCIES):
        stiffness = float(M[at, at] * w**2)
        out.append(with_spring(model, new, stiffness, float(2 * DAMPING * stiffness / w)))
    return out
