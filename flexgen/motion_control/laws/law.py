"""The base of laws that are computed for a planned motion."""

from __future__ import annotations

from abc import ABC, abstractmethod

from flexgen.errors import ArgumentError
from flexgen.loop.interface import Compiled, Controller, Setup
from flexgen.motion_control.laws.motion import LawMotion
from flexgen.type_checks import checked_methods


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
            f"controller: given {type(self).__name__}, which is computed for a planned motion, expected another one "
            "here; use it in flexgen.control"
        )
