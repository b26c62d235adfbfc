"""Residuals of a parametric model against measured frequency responses, and their sums for the
normal equations.

===========  ======================================================================================
"nls"        ``r = (G(x) - G) / sd``, element by element
"lls"        ``r = log(G(x) / G) / (sd / |G|)``, the complex logarithm
"structured" ``r = L^-1 (G(x) - G) (U U^H)^(1/2) P^(1/2)``, ``L L^H = G S_u G^H + w^(2 m) S_y``:
             the noise of torques and of outputs is white and independent, one variance for each;
             m: derivatives up to an acceleration
===========  ======================================================================================

In closed loop the noise of the torques is correlated with that of the outputs, and weights
``U U^H`` that contain it bias the parameters (errors in variables). With structured weights the
cost is therefore compensated by the noise parts of ``Y U^H`` and ``U U^H``, so that its derivative
has the mean 0 at the true parameters:

    sum |r|^2 + P tr L^-H L^-1 (2 Re G(x) N_yu^H - G(x) N_uu G(x)^H)

Combinations of torques whose noise has many times the power of the excitation have less weight.

Source: T. Soderstrom, Automatica 43(6), 2007 (errors-in-variables methods; bias-compensated least
squares).
"""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Literal, get_args

import numpy as np
from scipy.linalg import eigh

from flexgen.base.errors import ArgumentError
from flexgen.identification.estimator.problem import Problem, Sums, normal
from flexgen.identification.experiments.operating_points import along_x
from flexgen.identification.responses.frequency_response import Frf
from flexgen.identification.responses.local_model import LocalModel, Response, Rest
from flexgen.identification.responses.noise_structure import (
    fit_levels,
    regular,
    structured_covariance,
)
from flexgen.identification.responses.parameters import ParameterVector
from flexgen.identification.responses.response_inputs import Drive
from flexgen.identification.responses.response_outputs import ANGLE

ResidualName = Literal["nls", "lls"]
RESIDUALS: tuple[ResidualName, ...] = get_args(ResidualName)
LEAST_RELATIVE_SD = 1e-9  # of responses without noise
AVERAGINGS = 3  # of springs: the deflections depend on the stiffness and the reverse
SMOOTHED = 7  # lines over which a variance from few realizations is averaged
# power of noise over that of the spectra, above which a combination of torques has less weight
NOISY = 4.0
EXCESS = 2.0  # measured variance over that of the structure, above which the former is taken
# part of the information of a direction that is noise of the torques, above which it is none
MOST_BY_NOISE = 0.08
# deviations above the noise; variances of single elements, from few periods, vary more
SURE = 8.0
SURE_ALONE = 30.0
UNKNOWN = 1.0  # standard deviation of the logarithm that changes most in such a direction


class Residuals:
    """The residuals of one set of responses, as functions of x.

    Parameters
    ----------
    vector : ParameterVector
    data : Frf
    kind : str
        ``"nls"`` or ``"lls"``.
    floor : float
        Model error: part of ``|G|`` that is added to the standard deviations.
    deflection_sd : array (k, springs), optional
        Deviations over which springs that are not linear are averaged; see `average_springs`.
    """

    def __init__(
        self,
        vector: ParameterVector,
        data: Frf,
        kind: str = "nls",
        floor: float = 0.0,
        deflection_sd: np.ndarray | None = None,
    ) -> None:
        self.vector = vector
        self.data = data
        self.kind = kind
        self.local = LocalModel(vector.model, vector.of_model, data.sensors)
        self.drive = Drive(data.sample_s, data.delay_s)
        self.variance = _noise(data, floor)
        # L^-1 and (U U^H)^(1/2) P^(1/2), weighted
        self._white: tuple[np.ndarray, np.ndarray] | None = None
        # inverse of the latter, weights, noise
        self._noisy: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        self._rest: tuple[np.ndarray, Rest] | None = None
        none = np.zeros((len(data.poses), len(self.local.springs)))
        self.deflection_sd = none if deflection_sd is None else deflection_sd
        self.count = data.G.size  # of complex residuals

    def response(self, x: np.ndarray, derivatives: bool = False) -> Response:
        """The model's responses, and their derivatives in x."""
        values, rest = self.rest(x)
        drive = self.vector.drive_at(x, self.drive)
        found = self.local.response(
            values, self.data.poses, self.data.w, drive, speed_sd=self.data.speed_sd,
            deflection_sd=self.deflection_sd, derivatives=derivatives, rest=rest,
        )  # fmt: skip
        if not derivatives:
            return found
        assert found.dG is not None
        return Response(
            found.G, along_x(self.vector, self.local, x, found.G, found.dG, self.data.w)
        )

    def rest(self, x: np.ndarray) -> tuple[np.ndarray, Rest]:
        """The values of the model's numbers (n_p,), and the poses at rest."""
        named = self.vector.named(x)
        values = np.array([named[name] for name in self.local.names])
        if self._rest is None or not np.array_equal(self._rest[0], values):
            self._rest = values, self.local.rest(values, self.data.poses, self.deflection_sd)
        return self._rest

    def against(self, G: np.ndarray) -> Residuals:
        """Copy of the residuals with the same weights, against other responses."""
        out = copy.copy(self)
        out.data = replace(self.data, G=G)
        return out

    def on(self, data: Frf, floor: float = 0.0, extra: np.ndarray | float = 0.0) -> Residuals:
        """The residuals of the same model against other responses, or with other weights.

        ``extra`` (k, lines, n_m, n_m): variance of each element in addition to its noise.
        """
        out = copy.copy(self)
        out.data = data
        out.variance = _noise(data, floor) + extra
        out.drive = Drive(data.sample_s, data.delay_s)
        return out

    def of(self, vector: ParameterVector) -> Residuals:
        """The residuals of another model, or with other numbers free, with the same weights."""
        out = copy.copy(self)
        out.vector = vector
        out._rest = None
        out.local = LocalModel(vector.model, vector.of_model, self.data.sensors)
        return out

    def average_springs(self, x: np.ndarray) -> None:
        """Average springs that are not linear over the deflections that the torques of the data
        cause at x.
        """
        if not self.local.springs:
            return
        values, _ = self.rest(x)
        UU = self.data.UU / self.data.experiments
        for _ in range(AVERAGINGS):
            self.deflection_sd = self.local.deflection_sd(
                values,
                self.data.poses,
                self.data.w,
                self.vector.drive_at(x, self.drive),
                UU,
                self.data.speed_sd,
                self.deflection_sd,
            )
        self._rest = None

    def use_structure(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """From now on structured weights; returns the deviations of the spectra of torque and
        angle noise (n_m,).

        The covariances come from the data; their structure from the responses at x.
        """
        G = self.response(x).G
        w = self.data.w
        C = covariance_at(self.data, G)
        torque, output = noise_levels(replace(self.data, C=C), G)
        L = np.linalg.cholesky(
            structured_covariance(G, output_powers(self.data, w), torque, output)
        )
        white = np.linalg.inv(L)
        # transients that are left, responses that change between two frequencies
        if self.data.noise_UU is not None:
            excess = np.einsum("kloo->klo", white @ C @ white.conj().swapaxes(-1, -2)).real
            white = white / np.sqrt(np.where(excess > EXCESS, excess, 1.0))[..., None]
        right = np.linalg.cholesky(self.data.UU) * np.sqrt(self.data.periods)
        if self.data.noise_UU is not None:
            inverse = np.linalg.inv(right)
            back = inverse.conj().swapaxes(-1, -2)
            noise, V = np.linalg.eigh(self.data.periods * inverse @ self.data.noise_UU @ back)
            weight = 1 / (1 + (np.maximum(noise, 0.0) / NOISY) ** 4)
            root = np.sqrt(weight)[..., None, :]
            right = right @ V * root
            self._noisy = back @ V * root, weight, np.maximum(noise, 0.0)
            self.count = self.data.G.shape[2] * float(weight.sum())
        self._white = white, right
        self.kind = "structured"
        return np.sqrt(torque), np.sqrt(output)

    def weight(self, x: np.ndarray, derivatives: bool) -> tuple[np.ndarray, np.ndarray | None]:
        """Residuals (k, lines, n_m, n_m) and their Jacobian (..., n)."""
        return self._weigh(self.response(x, derivatives))

    def _weigh(self, found: Response) -> tuple[np.ndarray, np.ndarray | None]:
        G = found.G
        dG = found.dG
        if self.kind == "structured":
            assert self._white is not None
            left, right = self._white
            r = left @ (G - self.data.G) @ right
            J = (
                None
                if dG is None
                else np.einsum("klia,klabp,klbj->klijp", left, dG, right, optimize=True)
            )
            return r, J
        if self.kind == "lls":
            if not (G.all() and self.data.G.all()):
                raise ArgumentError(
                    'residual: given "lls", expected "nls": a response is zero, and has no '
                    "logarithm"
                )
            weight = np.abs(self.data.G) / np.sqrt(self.variance)
            return np.log(G / self.data.G) * weight, None if dG is None else dG * (weight / G)[
                ..., None
            ]
        weight = 1.0 / np.sqrt(self.variance)
        return (G - self.data.G) * weight, None if dG is None else dG * weight[..., None]

    def misfit(self, x: np.ndarray) -> float:
        """Sum of the squares."""
        return float((np.abs(self.weight(x, False)[0]) ** 2).sum())

    def find_unexplained(self, x: np.ndarray) -> float:
        """Part of an element of the responses that noise does not explain, of the element with the
        largest; 0: none.

        Elements one by one, over poses and lines: in most of them noise can hide what is wrong in
        one.
        """
        r, size = (
            np.abs(self._weigh(Response(G, None))[0]) ** 2
            for G in (self.response(x).G, 2 * self.data.G)
        )
        count = (
            np.full(r.shape[-1], r[..., 0, 0].size)
            if self._noisy is None
            else self._noisy[1].sum(axis=(0, 1))
        )
        total = r.sum(axis=(0, 1))
        sure = total > count + (SURE_ALONE if self._noisy is None else SURE) * np.sqrt(count)
        return float(
            np.sqrt(np.max((total - count) / size.sum(axis=(0, 1)), where=sure, initial=0.0))
        )

    def cost(self, x: np.ndarray) -> float:
        """Sum of the squares, compensated."""
        found = self.response(x)
        return float((np.abs(self._weigh(found)[0]) ** 2).sum()) + self._compensation(found.G)[0]

    @property
    def problem(self) -> Problem:
        """The problem of estimation, in x."""
        return self.vector.problem(self.sums, self.cost)

    def sums(self, x: np.ndarray) -> Sums:
        """Compensated sum of the squares, half its derivative, and ``Re J^H J``."""
        found = self.response(x, True)
        r, J = self._weigh(found)
        value, change = self._compensation(found.G)
        total, _, A = normal(r, J)
        return total + value, normal(r + change, J)[1], A

    def _compensation(self, G: np.ndarray) -> tuple[float, np.ndarray | float]:
        """Compensation of the cost for noise of the torques, and ``Z``: half its derivative is
        ``Re J^H Z``.
        """
        if self._noisy is None or self._white is None:
            return 0.0, 0.0
        (left, right) = self._white
        back = self._noisy[0]
        left_YU = self.data.periods * left @ self.data.noise_YU @ back
        change = left_YU - self.data.periods * left @ G @ self.data.noise_UU @ back
        return float(np.vdot(left @ G @ right, change + left_YU).real), change

    def covariance(self, x: np.ndarray, A: np.ndarray) -> np.ndarray:
        """Covariance (n, n) of x at the minimum: ``H (B/2 + W) H`` (sandwich), ``H = (A + W)^-1``.

        ``A = Re J^H J``; W: information of the prior, whose center is as uncertain as it says. B
        has the covariances between the elements of a response that the weights leave out. With
        structured weights A is without, and B with, what the noise of the torques seems to excite.
        Directions of which that is much are not determined: the motor hardly moves, and the
        compensation is the difference of two uncertain numbers.
        """
        prior = np.diag(self.vector.prior_sd**-2.0)
        _, J = self.weight(x, True)
        assert J is not None
        if self.kind == "structured":
            _, weight, noise = self._noisy or (0.0, np.ones(1), np.zeros(1))
            by_noise, B = (
                normal(np.zeros(J.shape[:-1]), J * np.sqrt(x)[:, :, None, :, None])[2]
                if self._noisy
                else y
                for x, y in (
                    (noise, 0 * A),
                    (weight * (1 + noise / max(self.data.periods - 1, 1)), A),
                )
            )
            share, X = eigh(by_noise, A + prior)
            known = share <= MOST_BY_NOISE
            inverse = X * (known / (1.0 - np.minimum(share, MOST_BY_NOISE))) @ X.T
            lost = UNKNOWN * X[:, ~known] / np.abs(X[:, ~known]).max(axis=0, initial=1e-300)
            return inverse @ (0.5 * B + prior) @ inverse + lost @ lost.T
        inverse = np.linalg.inv(A + prior)
        if self.kind == "lls":
            # of small errors, in sd
            to_weight = np.abs(self.data.G / self.response(x).G) / np.sqrt(self.variance)
        else:
            to_weight = 1.0 / np.sqrt(self.variance)
        Z = J * to_weight[..., None]
        if self.data.total is not None:
            flat = (Z * np.sqrt(self.variance)[..., None]).reshape(-1, J.shape[-1])
        else:
            Lc = np.linalg.cholesky(regular(self.data.C))
            Ls = np.linalg.cholesky(
                regular(np.linalg.inv(self.data.UU).swapaxes(-1, -2) / self.data.periods)
            )
            flat = np.einsum("klai,klabp,klbj->klijp", Lc.conj(), Z, Ls.conj(), optimize=True)
            flat = flat.reshape(-1, J.shape[-1])
            # model error
            beside = Z * np.sqrt(np.maximum(self.variance - self.data.variance, 0.0))[..., None]
            flat = np.vstack([flat, beside.reshape(-1, J.shape[-1])])
        B = np.real(flat.conj().T @ flat)
        return inverse @ (0.5 * B + prior) @ inverse


def covariance_at(data: Frf, G: np.ndarray) -> np.ndarray:
    """Covariance of ``Y - G U`` in one period: that of the data is of their own responses, which
    noise disturbs.
    """
    if data.noise_UU is None or data.noise_YU is None:
        return data.C
    away = data.G - G
    scale = data.periods / data.experiments
    cross = away @ (data.noise_YU - data.G @ data.noise_UU).conj().swapaxes(-1, -2)
    change = (
        cross + cross.conj().swapaxes(-1, -2) + away @ data.noise_UU @ away.conj().swapaxes(-1, -2)
    )
    return np.asarray(data.C + scale * change)


def output_powers(data: Frf, w: np.ndarray) -> np.ndarray:
    """``w^(2 m)`` (lines, outputs)."""
    orders = np.array([ANGLE] * len(data.motors) + list(data.orders))
    return np.asarray(w[:, None] ** (2 * orders))


def noise_levels(data: Frf, G: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Variances of the spectra of the noise of torques (n_m,) and outputs (n_o,), from the
    covariances of the data.
    """
    return fit_levels(data.C, G, output_powers(data, data.w))


def _noise(data: Frf, floor: float) -> np.ndarray:
    """Variances of the elements by noise, and by a model error that is a part of their size."""
    noise = (
        data.variance
        if data.total is None
        else np.maximum(_smooth_variances(data.total, data.G), data.variance)
    )
    return np.asarray(noise + (floor**2 + LEAST_RELATIVE_SD**2) * np.abs(data.G) ** 2)


def _smooth_variances(variance: np.ndarray, G: np.ndarray) -> np.ndarray:
    """Variances averaged over neighboring lines, relative to ``|G|^2``."""
    relative = variance / np.abs(G) ** 2
    return over_lines(relative, SMOOTHED) * np.abs(G) ** 2


def over_lines(x: np.ndarray, count: int) -> np.ndarray:
    """Means over ``count`` neighboring lines, axis 1; fewer at the ends."""
    out = np.empty_like(x)
    for line in range(x.shape[1]):
        out[:, line] = x[:, max(0, line - count // 2) : line + count // 2 + 1].mean(axis=1)
    return out
