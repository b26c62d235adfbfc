"""DLPack: arrays of other packages on the GPU without copies, by the Python capsules of its
version 1.

See https://dmlc.github.io/dlpack/latest/python_spec.html.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any, NamedTuple

CUDA = 2  # kinds of devices
MANAGED = 13  # memory of the second kind is on the CPU and on all cards
_FLOAT = 2
_NAME = b"dltensor"
_USED = b"used_dltensor"


class _Tensor(ctypes.Structure):
    _fields_ = (
        ("data", ctypes.c_void_p),
        ("device_kind", ctypes.c_int32),
        ("device", ctypes.c_int32),
        ("ndim", ctypes.c_int32),
        ("code", ctypes.c_uint8),
        ("bits", ctypes.c_uint8),
        ("lanes", ctypes.c_uint16),
        ("shape", ctypes.POINTER(ctypes.c_int64)),
        ("strides", ctypes.POINTER(ctypes.c_int64)),
        ("byte_offset", ctypes.c_uint64),
    )


class _Managed(ctypes.Structure):
    pass


_Deleter = ctypes.CFUNCTYPE(None, ctypes.POINTER(_Managed))
_Managed._fields_ = (("tensor", _Tensor), ("context", ctypes.c_void_p), ("deleter", _Deleter))
_Destructor = ctypes.CFUNCTYPE(None, ctypes.c_void_p)


def _python(name: str, result: Any, *arguments: Any) -> Callable[..., Any]:
    return ctypes.PYFUNCTYPE(result, *arguments)((name, ctypes.pythonapi))


_new = _python(
    "PyCapsule_New", ctypes.py_object, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p
)
_pointer = _python("PyCapsule_GetPointer", ctypes.c_void_p, ctypes.py_object, ctypes.c_char_p)
_raw_pointer = _python("PyCapsule_GetPointer", ctypes.c_void_p, ctypes.c_void_p, ctypes.c_char_p)
_raw_is = _python("PyCapsule_IsValid", ctypes.c_int, ctypes.c_void_p, ctypes.c_char_p)
_rename = _python("PyCapsule_SetName", ctypes.c_int, ctypes.py_object, ctypes.c_char_p)


class Imported(NamedTuple):
    """Contents of a capsule; strides in bytes; `release` gives the memory back to its owner."""

    address: int
    shape: tuple[int, ...]
    strides: tuple[int, ...] | None
    dtype: str
    release: Callable[[], None]


def take(capsule: Any) -> Imported:
    """The array of a capsule, which cannot be taken again; ValueError where it is none of
    version 1.
    """
    managed = ctypes.cast(_pointer(capsule, _NAME), ctypes.POINTER(_Managed))
    _rename(capsule, _USED)
    x = managed.contents.tensor
    size = x.bits // 8
    shape = tuple(x.shape[: x.ndim])
    strides = tuple(size * step for step in x.strides[: x.ndim]) if x.strides else None
    dtype = f"<f{size}" if x.code == _FLOAT and x.lanes == 1 else f"type {x.code} of {x.bits} bits"

    def release() -> None:
        if managed.contents.deleter:
            managed.contents.deleter(managed)

    return Imported((x.data or 0) + x.byte_offset, shape, strides, dtype, release)


# what keeps the memory of a capsule, until its user deletes it
exported: dict[int, tuple[Any, ...]] = {}


@_Deleter
def _delete(managed: Any) -> None:
    exported.pop(ctypes.addressof(managed.contents), None)


@_Destructor
def _destroy(capsule: int) -> None:
    if _raw_is(capsule, _NAME):  # it was not taken
        exported.pop(_raw_pointer(capsule, _NAME), None)


def give(
    owner: Any,
    address: int,
    shape: tuple[int, ...],
    strides: tuple[int, ...],
    itemsize: int,
    device: int,
) -> Any:
    """A DLPack capsule of an array of real numbers of ``itemsize`` bytes on a CUDA ``device``,
    which keeps its owner alive; strides in bytes.
    """
    dims = ctypes.c_int64 * len(shape)
    extents = dims(*shape)
    steps = dims(*(step // itemsize for step in strides))
    managed = _Managed()
    managed.tensor = _Tensor(
        address,
        CUDA,
        device,
        len(shape),
        _FLOAT,
        8 * itemsize,
        1,
        ctypes.cast(extents, ctypes.POINTER(ctypes.c_int64)),
        ctypes.cast(steps, ctypes.POINTER(ctypes.c_int64)),
        0,
    )
    managed.deleter = _delete
    where = ctypes.addressof(managed)
    exported[where] = (managed, extents, steps, owner)
    return _new(where, _NAME, ctypes.cast(_destroy, ctypes.c_void_p))
