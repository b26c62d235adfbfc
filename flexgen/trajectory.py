"""Trajectories: named channels over one time grid, saved as npz or csv without loss."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from flexgen import trajectory_files
from flexgen.errors import ArgumentError
from flexgen.ports import Port


@dataclass(frozen=True)
class Trajectory:
    """Channels sampled on one time grid.

    Parameters
    ----------
    time : array, shape (n,) [s]
        Strictly increasing.
    channels : mapping from name to array, shape (n, width)
    ports : mapping from name to Port
        Shape ``(width,)``, unit and meaning of each channel.
    labels : mapping from name to tuple of str
        One label for each column (the name of the coordinate or motor).
    meta : dict
        JSON types only: ``model``, ``variant``, ``move``, ``kind``; ``torque`` is ``"limited"`` where limits may be
        active and an interpolation must not exceed them.
    """

    time: np.ndarray
    channels: Mapping[str, np.ndarray]
    ports: Mapping[str, Port]
    labels: Mapping[str, tuple[str, ...]]
    meta: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n = len(self.time) if np.ndim(self.time) == 1 else 0
        if n < 2 or not np.isfinite(self.time).all() or not np.all(np.diff(self.time) > 0):
            raise ArgumentError(
                "trajectory: given a time grid that does not increase, expected at least 2 increasing instants"
            )
        if not self.ports.keys() == self.channels.keys() == self.labels.keys():
            raise ArgumentError(
                "trajectory: given channels, ports and labels with different names, expected the same names"
            )
        for name, port in self.ports.items():
            if len(self.labels[name]) != port.size:
                raise ArgumentError(
                    f"trajectory channel {name}: given {len(self.labels[name])} labels, expected {port.size}"
                )
            shape = np.shape(self.channels[name])
            if shape != (n, *port.shape):
                raise ArgumentError(f"trajectory channel {name}: given shape {shape}, expected {(n, *port.shape)}")

    def __getitem__(self, name: str) -> np.ndarray:
        try:
            return self.channels[name]
        except (KeyError, TypeError):
            near = difflib.get_close_matches(name, self.channels, 1) if isinstance(name, str) else []
            meant = (
                f"{near[0]} (there are: {', '.join(self.channels)})" if near else f"one of {', '.join(self.channels)}"
            )
            time = "; the time is the attribute .time" if name in ("t", "time") else ""
            raise ArgumentError(f"trajectory channel: given {name!r}, expected {meant}{time}") from None

    def save(self, path: str | Path) -> Path:
        """Write to ``path``: ``.npz`` with all data, ``.csv`` with a column for each scalar, ``name[label] unit``.

        The file is complete or as it was before, whatever happens (a full disk, a killed process). ArgumentError where
        it cannot be written.
        """
        path = Path(path)
        trajectory_files.write(path, self.time, self.channels, self.ports, self.labels, self.meta)
        return path

    @staticmethod
    def load(path: str | Path) -> Trajectory:
        """Read a file that `save` wrote; ArgumentError where the file is no trajectory or was cut."""
        path = Path(path)
        content = trajectory_files.read(path)
        try:
            return Trajectory(content.time, content.channels, content.ports, content.labels, content.meta)
        except ArgumentError as error:
            raise ArgumentError(f"{path}: {error}") from None
