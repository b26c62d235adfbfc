"""A library in PyTorch, on the CPU: one ``autograd.Function`` for functions and their products
with derivatives.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch

from flexgen.backends.autodiff.points import COTANGENT, TANGENT, Functions, Points, module
from flexgen.base.errors import ArgumentError, BuildError
from flexgen.base.spec.ports import Port
from flexgen.runtime.library import Library


def functions_of(library: Library) -> Functions:
    """See `flexgen.torch.functions`."""
    points = Points(library)
    module()  # (no compiler: an error here, not in the first call)
    return Functions(points, {name: _function(points, name) for name in points.own()})


def _function(points: Points, name: str) -> Callable[..., Any]:
    """A function for users: arguments of any type of real numbers, checked."""
    described = points.functions[name]

    def call(*args: Any, **named: Any) -> Any:
        """Check and convert the arguments, each of one point or many, and call through PyTorch."""
        given = points.arguments(name, args, named)
        arrays = [
            _tensor(name, port, x, _real(points))
            for port, x in zip(described.inputs, given, strict=True)
        ]
        points.lead(name, [tuple(x.shape) for x in arrays])
        return points.results(name, _Call.apply(points, name, *arrays))

    call.__name__ = call.__qualname__ = name
    call.__doc__ = described.__doc__
    return call


def _real(points: Points) -> torch.dtype:
    return torch.float64 if points.real == np.float64 else torch.float32


def _tensor(name: str, port: Port, x: Any, real: torch.dtype) -> torch.Tensor:
    """The argument as a tensor of the library's type on the CPU; a tensor that is one is not
    copied.
    """
    if not isinstance(x, torch.Tensor):
        return torch.as_tensor(np.array(x, dtype=float), dtype=real)
    if x.is_complex() or x.dtype == torch.bool:
        raise ArgumentError(
            f"{name}, {port.name}: given entries of type {x.dtype}, expected real numbers"
        )
    if x.device.type != "cpu":
        raise ArgumentError(
            f"{name}, {port.name}: given a tensor on {x.device}, expected one on the CPU: x.cpu()"
        )
    return x.to(real)


def evaluate(
    points: Points, name: str, arrays: Sequence[torch.Tensor]
) -> tuple[torch.Tensor, ...]:
    """The results by C, which reads and writes the tensors where they are."""
    function = points.functions[name]
    real = _real(points)
    lead = points.lead(name, [tuple(x.shape) for x in arrays])
    held = [x.contiguous() for x in arrays]
    made = [torch.empty((*lead, *port.shape), dtype=real) for port in function.outputs]
    where = (ctypes.c_void_p * (len(held) + len(made)))(*(x.data_ptr() for x in (*held, *made)))
    many = (ctypes.c_int32 * len(held))(
        *(x.dim() > len(port.shape) for x, port in zip(held, function.inputs, strict=True))
    )
    count = ctypes.c_int64(int(np.prod(lead, dtype=np.int64)))
    if module().flexgen_points(ctypes.byref(points.entries[name]), count, where, many) != 0:
        raise BuildError(
            f"{name}: given {count.value} points, which the library refused; generate it again"
        )
    return tuple(made)


class _Call(torch.autograd.Function):
    """A function of the library: ``apply(points, name, *inputs)``, a tuple of its results."""

    @staticmethod
    def forward(points: Points, name: str, *arrays: torch.Tensor) -> tuple[torch.Tensor, ...]:
        return evaluate(points, name, arrays)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        ctx.points, ctx.name, *arrays = inputs
        ctx.save_for_backward(*arrays)
        ctx.save_for_forward(*arrays)

    @staticmethod
    def backward(ctx: Any, *weights: torch.Tensor) -> tuple[Any, ...]:
        """Gradients of the inputs for weights of the results, by the function ``NAME_vjp``; those
        of arrays that a batch shares are summed.
        """
        points = ctx.points
        name = ctx.name
        points.check_order(name)
        function = points.functions[name]
        product = points.product(name, "vjp")
        values = {port.name: x for port, x in zip(function.inputs, ctx.saved_tensors, strict=True)}
        values |= {
            port.name + COTANGENT: w for port, w in zip(function.outputs, weights, strict=True)
        }
        back = _Call.apply(points, product.name, *(values[port.name] for port in product.inputs))
        found = {port.name: g for port, g in zip(product.outputs, back, strict=True)}
        results: list[torch.Tensor | None] = []
        for port, x in zip(function.inputs, ctx.saved_tensors, strict=True):
            gradient = found.get(port.name + COTANGENT)
            results.append(None if gradient is None else gradient.sum_to_size(x.shape))
        return None, None, *results

    @staticmethod
    def jvp(ctx: Any, *changes: Any) -> tuple[torch.Tensor, ...]:
        """Change of the results for changes of the inputs, None: zero, by the function
        ``NAME_jvp``.
        """
        points = ctx.points
        name = ctx.name
        points.check_order(name)
        inputs = points.functions[name].inputs
        product = points.product(name, "jvp")
        values = {port.name: x for port, x in zip(inputs, ctx.saved_tensors, strict=True)}
        for port, dx in zip(inputs, changes[2:], strict=True):
            values[port.name + TANGENT] = torch.zeros_like(values[port.name]) if dx is None else dx
        lead = points.lead(name, [tuple(x.shape) for x in ctx.saved_tensors])
        first = product.inputs[0]  # (has the batch, also where what has it is left out)
        values[first.name] = values[first.name].expand(*lead, *first.shape)
        return _Call.apply(points, product.name, *(values[port.name] for port in product.inputs))

    @staticmethod
    def vmap(
        info: Any, axes: Sequence[int | None], points: Points, name: str, *arrays: torch.Tensor
    ) -> Any:
        """A new axis in front; arrays without any axis of a batch stay as they are."""
        ports = points.functions[name].inputs
        moved = [
            x if axis is None else x.movedim(axis, 0)
            for x, axis in zip(arrays, axes[2:], strict=True)
        ]
        starts = [int(axis is not None) for axis in axes[2:]]
        shapes = [tuple(x.shape[start:]) for x, start in zip(moved, starts, strict=True)]
        lead = points.lead(name, shapes)
        given = []
        for x, start, shape, port in zip(moved, starts, shapes, ports, strict=True):
            depth = len(shape) - len(port.shape)
            if start:
                x = x.reshape(info.batch_size, *((1,) * (len(lead) - depth)), *shape)
            given.append(x.expand(info.batch_size, *lead, *port.shape) if start or depth else x)
        return _Call.apply(points, name, *given), (0,) * len(points.functions[name].outputs)
