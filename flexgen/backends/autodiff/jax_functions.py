"""A library in JAX, on the CPU: two primitives, the function and its linear part, and one handler
for both.

The rules of the primitives: ``jvp`` of a function is its linear part, ``NAME_jvp``; the transpose
of the linear part is ``NAME_vjp``; a batch is an axis in front of all arrays that have it.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from flexgen.backends.autodiff.points import COTANGENT, TANGENT, Functions, Points, lead_of, module
from flexgen.base.errors import ArgumentError
from flexgen.base.spec.ports import Port

TARGET = "flexgen_points"
_point = Primitive("flexgen_point")
_linear = Primitive("flexgen_linear")  # operands: the inputs, then their changes
_point.multiple_results = _linear.multiple_results = True


def functions_of(library: Any) -> Functions:
    """See `flexgen.jax.functions`."""
    points = Points(library)
    check_type(points)
    handler = _handler()
    for entry in points.entries.values():
        if handler.flexgen_register(ctypes.byref(entry)) != 0:
            raise ArgumentError(
                f"{library.name}: given too many libraries in one process; start another one"
            )
    return Functions(points, {name: _function(points, name) for name in points.own()})


@cache
def _handler() -> ctypes.CDLL:
    """The module with the handler, which XLA knows then."""
    made = module(
        str(Path(jax.ffi.include_dir(), "xla", "ffi", "api", "c_api.h")), jax.__version__
    )
    jax.ffi.register_ffi_target(
        TARGET, jax.ffi.pycapsule(made.flexgen_points_handler), platform="cpu"
    )
    return made


def check_type(points: Points) -> None:
    """ArgumentError where JAX has no numbers of the library's type."""
    if points.real == np.float64 and not jax.config.jax_enable_x64:
        raise ArgumentError(
            f"{points}: given JAX with numbers of single precision, expected double as in the "
            "library: call jax.config.update('jax_enable_x64', True) first, or generate the "
            "library with precision='single'"
        )


def _function(points: Points, name: str) -> Callable[..., Any]:
    """A function for users: arguments of any type of real numbers, checked."""
    described = points.functions[name]

    def call(*args: Any, **named: Any) -> Any:
        """Check and convert the arguments, each of one point or many, and call through JAX."""
        given = points.arguments(name, args, named)
        check_type(points)
        arrays = [
            _array(name, port, x, points.real)
            for port, x in zip(described.inputs, given, strict=True)
        ]
        points.lead(name, [x.shape for x in arrays])
        return points.results(name, _point.bind(*arrays, points=points, name=name))

    call.__name__ = call.__qualname__ = name
    call.__doc__ = described.__doc__
    return call


def _array(name: str, port: Port, x: Any, real: np.dtype) -> jax.Array:
    """The argument as an array of JAX of the library's type ``real``; ArgumentError for other
    numbers.
    """
    try:
        array = jnp.asarray(x)
    except (TypeError, ValueError) as error:
        raise ArgumentError(
            f"{name}, {port.name}: given {type(x).__name__}, expected an array of numbers"
        ) from error
    if not (jnp.issubdtype(array.dtype, jnp.floating) or jnp.issubdtype(array.dtype, jnp.integer)):
        raise ArgumentError(
            f"{name}, {port.name}: given entries of type {array.dtype}, expected real numbers"
        )
    return array.astype(real)


# --- the rules -----------------------------------------------------------------------------------


def _inputs(primitive: Primitive, points: Points, name: str) -> tuple[Port, ...]:
    inputs = points.functions[name].inputs
    return inputs if primitive is _point else (*inputs, *inputs)


def _abstract(primitive: Primitive, *avals: Any, points: Points, name: str) -> list[Any]:
    lead = lead_of(name, _inputs(primitive, points, name), [x.shape for x in avals])
    return [
        jax.core.ShapedArray((*lead, *port.shape), points.real)
        for port in points.functions[name].outputs
    ]


@cache
def _program(points: Points, name: str) -> Callable[..., Any]:
    return jax.jit(partial(_point.bind, points=points, name=name))


def _lower(ctx: Any, *operands: Any, points: Points, name: str) -> Any:
    return jax.ffi.ffi_lowering(TARGET)(ctx, *operands, key=np.int64(points.key(name)))


def _changes(*operands: Any, points: Points, name: str) -> Any:
    """The linear part by the function ``NAME_jvp``."""
    names = [port.name for port in points.functions[name].inputs]
    values = dict(zip([*names, *(n + TANGENT for n in names)], operands, strict=True))
    product = points.product(name, "jvp")
    given = [values[port.name] for port in product.inputs]
    lead = lead_of(name, _inputs(_linear, points, name), [x.shape for x in operands])
    # the batch is in what is left out
    if lead and not lead_of(name, product.inputs, [x.shape for x in given]):
        given[0] = jnp.broadcast_to(given[0], (*lead, *given[0].shape))
    return _point.bind(*given, points=points, name=product.name)


def _jvp(primals: Sequence[Any], tangents: Sequence[Any], *, points: Points, name: str) -> Any:
    points.check_order(name)
    out = _point.bind(*primals, points=points, name=name)
    changes = [ad.instantiate_zeros(t) for t in tangents]
    return out, _linear.bind(*primals, *changes, points=points, name=name)


def _jvp_of_linear(
    primals: Sequence[Any], tangents: Sequence[Any], *, points: Points, name: str
) -> Any:
    """Derivative of the function that is linear in its changes: the function itself in other
    changes. One in the point of linearization, a second derivative, is refused.
    """
    count = len(points.functions[name].inputs)
    if not all(isinstance(t, ad.Zero) for t in tangents[:count]):
        points.check_order(f"{name}_jvp")
    out = _linear.bind(*primals, points=points, name=name)
    changes = [ad.instantiate_zeros(t) for t in tangents[count:]]
    return out, _linear.bind(*primals[:count], *changes, points=points, name=name)


def _transpose(cotangents: Sequence[Any], *operands: Any, points: Points, name: str) -> list[Any]:
    """Cotangents of the changes by the function ``NAME_vjp``; those of arrays that a batch shares
    are summed.
    """
    function = points.functions[name]
    count = len(function.inputs)
    product = points.product(name, "vjp")
    values = {port.name: x for port, x in zip(function.inputs, operands[:count], strict=True)}
    for port, weight in zip(function.outputs, cotangents, strict=True):
        values[port.name + COTANGENT] = ad.instantiate_zeros(weight)
    back = _point.bind(
        *[values[port.name] for port in product.inputs], points=points, name=product.name
    )
    found = {port.name: g for port, g in zip(product.outputs, back, strict=True)}
    results: list[Any] = [None] * count
    for port, change in zip(function.inputs, operands[count:], strict=True):
        if not ad.is_undefined_primal(change):
            results.append(None)
            continue
        gradient = found.get(port.name + COTANGENT)
        if gradient is None:
            results.append(ad.Zero(change.aval))
        else:
            extra = gradient.ndim - len(change.aval.shape)
            results.append(gradient.sum(axis=tuple(range(extra))))
    return results


def _batch(
    primitive: Primitive,
    operands: Sequence[Any],
    axes: Sequence[Any],
    *,
    points: Points,
    name: str,
) -> tuple[Any, list[int]]:
    """A new axis in front; arrays without any axis of a batch stay as they are."""
    ports = _inputs(primitive, points, name)
    own = [
        x.ndim - (axis is not None) - len(port.shape)
        for x, axis, port in zip(operands, axes, ports, strict=True)
    ]
    (count,) = {x.shape[axis] for x, axis in zip(operands, axes, strict=True) if axis is not None}
    lead: tuple[int, ...] = ()
    moved = [
        x if axis is None else jnp.moveaxis(x, axis, 0)
        for x, axis in zip(operands, axes, strict=True)
    ]
    for x, axis, depth in zip(moved, axes, own, strict=True):
        start = int(axis is not None)
        lead = x.shape[start : start + depth] or lead
    given = []
    for x, axis, depth, port in zip(moved, axes, own, ports, strict=True):
        if axis is not None:
            x = jnp.broadcast_to(
                jnp.reshape(x, (count, *((1,) * (len(lead) - depth)), *x.shape[1:])),
                (count, *lead, *port.shape),
            )
        elif depth:
            x = jnp.broadcast_to(x, (count, *lead, *port.shape))
        given.append(x)
    out = primitive.bind(*given, points=points, name=name)
    return out, [0] * len(out)


for _primitive in (_point, _linear):
    _primitive.def_abstract_eval(partial(_abstract, _primitive))
    batching.primitive_batchers[_primitive] = partial(_batch, _primitive)
_point.def_impl(lambda *operands, points, name: _program(points, name)(*operands))
_linear.def_impl(_changes)
mlir.register_lowering(_point, _lower, platform="cpu")
mlir.register_lowering(_linear, mlir.lower_fun(_changes, multiple_results=True))
ad.primitive_jvps[_point] = _jvp
ad.primitive_jvps[_linear] = _jvp_of_linear
ad.primitive_transposes[_linear] = _transpose
