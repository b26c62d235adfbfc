"""The models of flexgen, each read once: lists of names for parameters of tests, made when tests
are collected.
"""

from __future__ import annotations

from functools import cache

from flexgen.model.elements import RobotModel
from flexgen.model.reader import model_names, read


@cache
def shipped(name: str) -> RobotModel:
    """A model by its name."""
    return read(name)


@cache
def named_variants(name: str) -> tuple[str, ...]:
    """The model and each of its variants, ``name@variant``."""
    return (name, *(f"{name}@{variant}" for variant in shipped(name).variants))


@cache
def all_variants() -> tuple[str, ...]:
    """Every model, each followed by its variants."""
    return tuple(variant for name in model_names() for variant in named_variants(name))


def elastic_models() -> list[str]:
    """Names of the models with more degrees of freedom than motors."""
    return [name for name in model_names() if shipped(name).dof > shipped(name).n_m]
