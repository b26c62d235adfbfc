"""A pose of the tool: of given joints, or of a position and a rotation vector."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from flexgen.base.errors import ArgumentError
from flexgen.codegen.build.model_library import library_with
from flexgen.model.elements import RobotModel


@dataclass(frozen=True, eq=False)
class ToolPose:
    """A pose of the tool in the world: ``position`` (3,) [m], ``rotation`` (3, 3) with its axes as
    columns.
    """

    position: np.ndarray
    rotation: np.ndarray

    @classmethod
    def of_joints(
        cls,
        model: RobotModel,
        joints: Sequence[float],
        progress: Callable[[str], None] | None = None,
    ) -> ToolPose:
        """The pose of the undeflected arm at these actuated coordinates (n_g,) [rad or m], by its
        C library.
        """
        if len(joints) != model.n_g:
            raise ArgumentError(f"--joints: given {len(joints)} numbers, expected {model.n_g}")
        library = library_with(model, ("forward_kinematics", "jacobian"), progress=progress)
        full = np.zeros(model.n_a)
        full[list(model.i_g)] = joints
        position, rotation = library.forward_kinematics(full)
        return cls(np.asarray(position), np.asarray(rotation))

    @classmethod
    def of_vectors(cls, position: Sequence[float], rotation: Sequence[float]) -> ToolPose:
        """The pose with this position (3,) [m] and rotation vector (3,) [rad]."""
        if len(position) != 3 or len(rotation) != 3:
            raise ArgumentError("--position, --rotation: expected three numbers each")
        return cls(np.array(position), Rotation.from_rotvec(rotation).as_matrix())

    def __str__(self) -> str:
        vector = Rotation.from_matrix(self.rotation).as_rotvec()
        where = f"position {np.round(self.position, 6).tolist()} m"
        return f"{where}, rotation vector {np.round(vector, 6).tolist()} rad"

    def to_dict(self) -> dict[str, Any]:
        """As JSON types."""
        return {"position_m": self.position.tolist(), "rotation": self.rotation.tolist()}
