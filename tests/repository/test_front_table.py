"""The table of the front room is that of the decorators, and nothing is imported for it."""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module

import front_table
import pytest

from flexgen.base.registry import find_function

PLOT = 'from flexgen.base.registry import provides\n\n@provides("Load.plot")\ndef plot(x): ...\n'


def test_the_table_has_the_functions_with_the_decorator():
    """`tests/golden/update.py front` writes it."""
    found = front_table.marked(front_table.sources())
    assert found == front_table.recorded()
    assert list(front_table.recorded()) == sorted(found)


def test_a_planted_function_is_seen():
    planted = front_table.sources() | {"flexgen.views.plots.load": PLOT}
    assert front_table.marked(planted)["Load.plot"] == "flexgen.views.plots.load:plot"
    twice = planted | {"flexgen.views.plots.other": PLOT}
    with pytest.raises(ValueError, match=r"Load\.plot: given by flexgen\.views\.plots\.load:plot"):
        front_table.marked(twice)
    unknown = {"flexgen.views.plots.load": PLOT.replace('"Load.plot"', "NAME")}
    with pytest.raises(ValueError, match="line 3: given no text, expected a name"):
        front_table.marked(unknown)


def test_each_function_knows_its_names():
    for name, target in front_table.recorded().items():
        module, _, function = target.partition(":")
        assert name in getattr(import_module(module), function).provides
        assert find_function(name) is getattr(import_module(module), function)


def test_the_front_room_imports_no_views():
    code = (
        "import sys, flexgen\n"
        "print([x for x in sys.modules if x.startswith(('matplotlib', 'flexgen.views', 'numpy'))])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == "[]\n"
