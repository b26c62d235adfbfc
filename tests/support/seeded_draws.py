"""Draws of a strategy, equal in every run."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis.strategies import SearchStrategy


def on_draws(
    check: Callable[[Any], None],
    strategy: SearchStrategy[Any],
    count: int,
    start: int,
    phases: tuple[Phase, ...] = (Phase.generate,),
) -> None:
    """A check of ``count`` draws from the seed ``start``, however long one takes."""
    settings(
        max_examples=count,
        phases=phases,
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
        print_blob=False,
    )(seed(start)(given(strategy)(check)))()
