"""Objects of classes in Python files: ``file.py:Class``."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

from flexgen.base.errors import ArgumentError, BuildError
from flexgen.runtime.files import read_verified, verify_file

LIBRARIES = (".so", ".dylib", ".dll")  # files of compiled controllers
_ADVICE = "use a copy of your own"


def is_python(text: str) -> bool:
    """Whether a text names a Python file, or a class in one."""
    return text.endswith(".py") or ".py:" in text


def module_of_file(name: str, path: Path) -> ModuleType:
    """Run a Python file as a module; BuildError where others could have changed it."""
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # (dataclasses look their module up)
    exec(compile(read_verified(verify_file(path), _ADVICE), str(path), "exec"), vars(module))
    return module


def object_of_file(text: str) -> Any:
    """An object of a class in a Python file: ``file.py:Class``; without a class the only one with
    ``step``.
    """
    file, _, name = text.partition(".py")
    path = Path(f"{file}.py")
    name = name.removeprefix(":")
    if not path.is_file():
        raise ArgumentError(f"controller: given {text!r}, expected a file {path} that is there")
    try:
        module = module_of_file(f"flexgen_controller_{path.stem}", path)
    except BuildError as error:
        raise ArgumentError(f"controller: {error}") from error
    except Exception as error:
        raise ArgumentError(
            f"{path}: {type(error).__name__} while it was loaded: {error}"
        ) from error
    own = {
        key: value
        for key, value in vars(module).items()
        if isinstance(value, type)
        and value.__module__ == module.__name__
        and hasattr(value, "step")
    }
    if name and name not in own:
        raise ArgumentError(
            f"{path}: given no class {name!r} with step(), expected one of "
            f"{', '.join(own) or 'none'}"
        )
    if not name and len(own) != 1:
        raise ArgumentError(
            f"{path}: given {len(own)} classes with step(), expected one, or its name: "
            f"{path}:Class"
        )
    made = own[name] if name else next(iter(own.values()))
    try:
        return made()
    except Exception as error:
        raise ArgumentError(
            f"{path}, {made.__name__}(): {type(error).__name__}: {error}"
        ) from error
