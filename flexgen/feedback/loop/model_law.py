"""The bases of feedback laws: those that are designed for poses, and those that are computed for a
planned motion.

The parameters of a class are the keys of its table in a controller file.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from flexgen.base.checks.type_checks import checked_methods
from flexgen.base.errors import ArgumentError
from flexgen.feedback.loop.controllers import Linear
from flexgen.feedback.loop.interface import Compiled, Controller, Setup
from flexgen.feedback.loop.law_motion import LawMotion
from flexgen.model.elements import RobotModel


class LinearDesign(ABC):
    """A law with parameters; `linear` designs the controller for the poses of a motion."""

    @property
    def title(self) -> str:
        """Name in tables."""
        return type(self).__name__

    @abstractmethod
    def linear(
        self,
        model: RobotModel,
        sample_s: float,
        delay_s: float,
        motion: Sequence[np.ndarray],
        samples: int = 1,
    ) -> Linear:
        """The controller for parts of a motion, of ``samples`` samples each; ``motion``: one point
        for each part.
        """


@checked_methods
class ModelLaw(ABC):
    """A feedback law with parameters; `bound` makes the controller for one motion of one model."""

    @property
    @abstractmethod
    def title(self) -> str:
        """Name in tables."""

    @abstractmethod
    def bound(self, motion: LawMotion) -> Controller:
        """The controller for a planned motion."""

    def compiled(self, setup: Setup) -> Compiled:
        """Refused: there is no motion."""
        raise ArgumentError(
            f"controller: given {type(self).__name__}, which is computed for a planned motion, "
            "expected another one here; use it in flexgen.control"
        )
