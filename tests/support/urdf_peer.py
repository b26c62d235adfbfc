"""The chain of an overlay in Pinocchio, from the URDF file and the text of the overlay alone.

All joints of the file are free in Pinocchio. The coordinates x of the overlay move them by
``q = T x + q0``: locked joints have a row of zeros, joints with <mimic> the factors of the joint
at the beginning of their chain. Then

    M = T' M_all T,    h = T' h_all(q, T v),    g = T' g_all(q)
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

GRAVITY = 9.81  # m/s^2, of an overlay without the key


class UrdfPeer:
    """Inertia matrix, bias and gravity of the coordinates of an overlay, from Pinocchio.

    Parameters
    ----------
    urdf : Path
        What Pinocchio reads.
    overlay : str
        Text of the overlay.
    coordinates : sequence of str
        Names in the overlay.
    """

    def __init__(self, urdf: Path, overlay: str, coordinates: Sequence[str]) -> None:
        self.pin = pytest.importorskip("pinocchio", reason="no pin; run: make setup-test")
        self.model = self.pin.buildModelFromUrdf(str(urdf))
        self.data = self.model.createData()
        tables = tomllib.loads(overlay)
        self.joints = {
            joint.get("name"): joint for joint in ElementTree.parse(urdf).getroot().iter("joint")
        }
        lock = tables["urdf"].get("lock", {})
        self.lock = dict.fromkeys(lock, 0.0) if isinstance(lock, list) else lock
        own = tables.get("joint", {})
        renamed = {table["rename"]: name for name, table in own.items() if "rename" in table}
        self.names = [renamed.get(name, name) for name in coordinates]
        self.T = np.zeros((self.model.nv, len(coordinates)))
        self.start = np.zeros(self.model.nv)
        for index in range(1, self.model.njoints):
            joint = self.model.joints[index]
            if joint.nv == 1:
                row, at = self._motion(self.model.names[index])
                self.T[joint.idx_v] = row
                self.start[joint.idx_v] = at
        for name in tables["urdf"].get("drop", []):
            if self.model.existJointName(name):
                for index in self.model.subtrees[self.model.getJointId(name)]:
                    self.model.inertias[index] = self.pin.Inertia.Zero()
        self._turn_gravity(tables["urdf"]["base"])

    def _turn_gravity(self, base: str) -> None:
        """Gravity is along -z of the base, which need not be the root of the file."""
        self.pin.framesForwardKinematics(self.model, self.data, self.place(self.T[0] * 0.0))
        axes = self.data.oMf[self.model.getFrameId(base)].rotation
        self.model.gravity.linear = axes @ np.array([0.0, 0.0, -GRAVITY])

    def _motion(self, name: str) -> tuple[np.ndarray, float]:
        """Factors of the coordinates that move a joint, and its position where these are zero."""
        row = np.zeros(len(self.names))
        if name in self.lock:
            return row, float(self.lock[name])
        if name in self.names:
            row[self.names.index(name)] = 1.0
            return row, 0.0
        mimic = self.joints[name].find("mimic")
        if mimic is None:
            return row, 0.0
        factors, at = self._motion(mimic.get("joint", ""))
        factor = float(mimic.get("multiplier", "1"))
        return factor * factors, factor * at + float(mimic.get("offset", "0"))

    def place(self, x: np.ndarray) -> np.ndarray:
        """The configuration of Pinocchio."""
        neutral = self.pin.neutral(self.model)
        return np.array(self.pin.integrate(self.model, neutral, self.start + self.T @ x))

    def mass_matrix(self, x: np.ndarray) -> np.ndarray:
        """Inertia matrix."""
        M = np.triu(self.pin.crba(self.model, self.data, self.place(x)))
        return np.array(self.T.T @ (M + np.triu(M, 1).T) @ self.T)

    def bias(self, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Torques of gravity and of the speeds."""
        still = np.zeros(self.model.nv)
        torques = self.pin.rnea(self.model, self.data, self.place(x), self.T @ v, still)
        return np.array(self.T.T @ torques)

    def gravity(self, x: np.ndarray) -> np.ndarray:
        """Torques of gravity."""
        found = self.pin.computeGeneralizedGravity(self.model, self.data, self.place(x))
        return np.array(self.T.T @ found)
