"""npz files byte by byte: arrays whose headers claim what is not there."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np


def packed(path: Path, members: dict[str, bytes]) -> Path:
    """A zip archive of npy files with the given bytes."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return path


def array_bytes(values: np.ndarray) -> bytes:
    """An npy file."""
    stream = io.BytesIO()
    np.save(stream, values)
    return stream.getvalue()


def claiming(shape: str, data: bytes = b"") -> bytes:
    """An npy file of doubles whose header claims a shape."""
    head = (
        f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".ljust(117).encode()
        + b"\n"
    )
    return b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head + data
