"""Grade of a fit: its misfit by element and band, and the error of feedforward with the model.

With a reference acceleration a the robot needs the torques u = G^-1 a, and the model gives G(x)^-1
a: the error of the feedforward, relative to the torques that the robot needs, is

    e = |S^-1 (G(x)^-1 G - I) S|_2,
    S: torques of the motors in the experiment (root mean square)

0: right; 1: as much as without feedforward. G are the responses of the motors. References have
their power below the lowest natural frequency with locked motors and, quick ones, about it.
Misfits of elements are relative to their size and without what noise explains; those of elements
that carry little torque weigh little in e.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexgen.identification.responses.frequency_response import Frf

# Error of the torques of a feedforward that is good enough, below the lowest natural frequency and
# about it.
GOOD_BELOW = 0.15
GOOD_ABOUT = 0.5
# Error of the torques from which a model is as good as none.
USELESS = 0.7
# Smallest error of the torques that is printed as a number: 0.1 %.
SHOWN = 1e-3
# Ends of the band about the lowest natural frequency, over that frequency.
ABOUT = (0.7, 1.5)


@dataclass(frozen=True)
class Band:
    """A band of frequencies, with the errors in it.

    ``low``, ``high`` [Hz]; ``torque_error``: median error e of the feedforward. ``misfit``
    (outputs, n_m): median misfit of each element relative to its size, without what noise
    explains.
    """

    name: str
    low: float
    high: float
    torque_error: float
    misfit: np.ndarray


@dataclass(frozen=True)
class Grade:
    """The grade of a fit: ``good`` enough for feedforward, ``reason`` in words, and the ``bands``.

    ``lowest_hz`` [Hz]: lowest natural frequency with locked motors; ``outputs``, ``motors``: of
    the elements.
    """

    good: bool
    reason: str
    lowest_hz: float
    bands: tuple[Band, ...]
    outputs: tuple[str, ...]
    motors: tuple[str, ...]

    @property
    def sentence(self) -> str:
        """Whether the model is good enough for feedforward, and why."""
        return (
            f"good enough for feedforward: {'yes' if self.good else 'no'}, because {self.reason}"
        )

    @property
    def worst(self) -> tuple[str, str, Band, float]:
        """Output and motor of the element with the largest misfit, its band, and the misfit."""
        found = []
        for band in self.bands:
            i, j = np.unravel_index(int(np.argmax(band.misfit)), band.misfit.shape)
            found.append((self.outputs[i], self.motors[j], band, float(band.misfit[i, j])))
        return max(found, key=lambda each: each[3])

    def to_dict(self) -> dict[str, object]:
        """As JSON types, SI units."""
        bands = [
            {
                "name": band.name,
                "low_Hz": band.low,
                "high_Hz": band.high,
                "torque_error": band.torque_error,
                "misfit": band.misfit.tolist(),
            }
            for band in self.bands
        ]
        return {
            "good_for_feedforward": self.good,
            "reason": self.reason,
            "lowest_frequency_Hz": self.lowest_hz,
            "bands": bands,
        }


def grade(data: Frf, G: np.ndarray, lowest_hz: float) -> Grade:
    """The grade of responses of a model.

    Parameters
    ----------
    data : Frf
        The measured responses.
    G : complex array (k, lines, outputs, n_m)
        Those of the model.
    lowest_hz : float [Hz]
        Lowest natural frequency with locked motors; 0: a rigid robot.
    """
    hz = data.w / (2 * np.pi)
    n_m = len(data.motors)
    misfit = np.sqrt(np.maximum(np.abs(G - data.G) ** 2 - data.variance, 0.0))
    misfit = misfit / np.maximum(np.abs(data.G), 1e-300)
    torques = np.sqrt(np.abs(np.einsum("kljj->klj", data.UU)).mean(axis=(0, 1)))
    S = np.maximum(torques, 1e-300 + 1e-9 * torques.max())
    wrong = np.linalg.solve(G[:, :, :n_m], data.G[:, :, :n_m]) - np.eye(n_m)
    errors = np.linalg.norm(wrong * S / S[:, None], ord=2, axis=(2, 3))
    low, high = (part * lowest_hz for part in ABOUT)
    edges = {"below": (0.0, low), "about": (low, high), "above": (high, np.inf)}
    if lowest_hz <= 0.0:
        edges = {"below": (0.0, np.inf)}
    bands = []
    for name, (first, last) in edges.items():
        chosen = (hz >= first) & (hz < last)
        if chosen.any():
            inside = hz[chosen]
            error = float(np.median(errors[:, chosen]))
            each = np.median(misfit[:, chosen], axis=(0, 1))
            bands.append(Band(name, float(inside[0]), float(inside[-1]), error, each))
    good, reason = _judge(bands, lowest_hz)
    return Grade(good, reason, lowest_hz, tuple(bands), data.outputs, data.motors)


def _judge(bands: list[Band], lowest_hz: float) -> tuple[bool, str]:
    """Whether the errors of the torques are small enough, and the reason."""
    known = {band.name: band for band in bands}
    limits = {"below": GOOD_BELOW, "about": GOOD_ABOUT}
    judged = [known[name] for name in limits if name in known] or bands[:1]
    wrong = [band for band in judged if not band.torque_error <= limits.get(band.name, GOOD_BELOW)]
    told = wrong[:1] or judged
    place = f" (lowest natural frequency: {lowest_hz:.3g} Hz)" if lowest_hz > 0.0 else ""
    words = " and ".join(
        f"{_percent(band.torque_error)} at {band.low:.3g} to {band.high:.3g} Hz" for band in told
    )
    reason = f"the torques of the model are off by {words}{place}"
    if wrong and wrong[0].torque_error > USELESS:
        size = "more than" if wrong[0].torque_error > 1.0 else "nearly as much as"
        reason += f", which is {size} without feedforward (100 %)"
    if "below" not in known and lowest_hz > 0.0:
        return False, f"{reason}; nothing was measured below it, where references have their power"
    return not wrong, reason


def _percent(part: float) -> str:
    """A part in percent; below `SHOWN` only that it is less."""
    if part < SHOWN:
        return f"less than {100 * SHOWN:g} %"
    return f"{100 * part:.0f} %" if part >= 1.0 else f"{100 * part:.2g} %"
