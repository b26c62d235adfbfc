"""Elements of XML with their lines, classes in Python files, and products of derivatives against
written forms.
"""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from flexgen.base.errors import ArgumentError
from flexgen.base.spec import xml_lines
from flexgen.dynamics.mechanics import products
from flexgen.feedback.loop import python_files


def test_elements_of_a_file_have_their_lines() -> None:
    root = xml_lines.parse(
        b'<robot name="r">\n <link a="1"/>\n\n <joint>\n  <axis\n   xyz="0"/></joint>text</robot>'
    )
    assert (root.tag, root.attributes, root.line) == ("robot", {"name": "r"}, 1)
    assert [(x.tag, x.line, x.attributes) for x in root.children] == [
        ("link", 2, {"a": "1"}),
        ("joint", 4, {}),
    ]
    assert [(x.tag, x.line, x.children) for x in root.children[1].children] == [("axis", 5, [])]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            b"<a>" * 65 + b"</a>" * 65,
            "line 1: given elements nested too deeply, expected at most 64 levels",
        ),
        (
            b"<a xmlns:x='http://xacro'>\n<x:if/></a>",
            (
                'line 2: given the element "if" of xacro, expected a URDF file that xacro has '
                "expanded"
            ),
        ),
        (
            b'<?xml version="1.0"?>\n<!DOCTYPE a>\n<a/>',
            (
                "line 2: given a document type or entities, expected a URDF file without "
                "<!DOCTYPE ...>"
            ),
        ),
        (
            b"<a>\n<b>\n</a>",
            "line 3: given text that is not XML (mismatched tag), expected a URDF file",
        ),
        (
            b'<?xml version="1.0" encoding="none"?><a/>',
            "line 1: given an unknown encoding, expected a URDF file in UTF-8",
        ),
    ],
)
def test_texts_that_are_refused_as_a_urdf_file(text: bytes, said: str) -> None:
    with pytest.raises(xml_lines.MarkupError) as refused:
        xml_lines.parse(text)
    assert str(refused.value) == said


def test_a_file_may_have_sixty_four_levels() -> None:
    node = xml_lines.parse(b"<a>" * 64 + b"</a>" * 64)
    depth = 1
    while node.children:
        (node,) = node.children
        depth = depth + 1
    assert depth == 64


TWO = """
class Own:
    def step(self): return 2

class Other:
    def __init__(self, number): self.number = number
    def step(self): return 3

class Plain: pass
from collections import OrderedDict
"""


def test_classes_of_a_python_file(tmp_path: Path) -> None:
    """The one that is named, or the only one with ``step`` that the file itself defines."""
    assert [python_files.is_python(x) for x in ("a.py", "a.py:B", "a.pyx", "a.so")] == [
        True,
        True,
        False,
        False,
    ]
    file = tmp_path / "two.py"
    file.write_text(TWO)
    assert python_files.object_of_file(f"{file}:Own").step() == 2
    for text, said in (
        (
            f"{file}",
            f"{file}: given 2 classes with step(), expected one, or its name: {file}:Class",
        ),
        (
            f"{file}:Plain",
            f"{file}: given no class 'Plain' with step(), expected one of Own, Other",
        ),
        (
            f"{tmp_path}/no.py:A",
            (
                f"controller: given '{tmp_path}/no.py:A', expected a file {tmp_path}/no.py that "
                "is there"
            ),
        ),
    ):
        with pytest.raises(ArgumentError) as refused:
            python_files.object_of_file(text)
        assert str(refused.value) == said
    with pytest.raises(ArgumentError, match=r"two.py, Other\(\): TypeError: .*'number'"):
        python_files.object_of_file(f"{file}:Other")
    file.write_text(TWO.partition("class Other")[0])
    assert python_files.object_of_file(str(file)).step() == 2
    file.write_text("class Plain: pass\n")
    with pytest.raises(ArgumentError) as refused:
        python_files.object_of_file(f"{file}:A")
    assert str(refused.value) == f"{file}: given no class 'A' with step(), expected one of none"
    file.write_text("1 / 0\n")
    with pytest.raises(ArgumentError) as refused:
        python_files.object_of_file(str(file))
    assert str(refused.value) == f"{file}: ZeroDivisionError while it was loaded: division by zero"


def test_products_of_derivatives_of_a_written_function() -> None:
    """f = [[x_0^2, x_0 x_1], [0, x_0 y]], g = x y: both products by hand."""
    x = ca.SX.sym("x", 2)
    y = ca.SX.sym("y")
    f = ca.vertcat(ca.horzcat(x[0] ** 2, x[0] * x[1]), ca.horzcat(0, x[0] * y))
    g = x * y
    at = np.array([2.0, -3.0])
    to = np.array([0.5, 0.25])
    one = 1.5
    step = -2.0
    given, names, found, named = products.jvp([x, y], ["x", "y"], [f, g], ["f", "g"])
    assert (names, named) == (["x", "y", "x_tangent", "y_tangent"], ["f_tangent", "g_tangent"])
    df, dg = (np.array(v) for v in ca.Function("jvp", given, found)(at, one, to, step))
    assert_allclose(df, [[2 * 2 * 0.5, 0.5 * -3 + 2 * 0.25], [0, 0.5 * 1.5 + 2 * -2]], rtol=1e-15)
    assert_allclose(dg[:, 0], [0.5 * 1.5 + 2 * -2, 0.25 * 1.5 - 3 * -2], rtol=1e-15)
    given, names, found, named = products.vjp([x, y], ["x", "y"], [f, g], ["f", "g"])
    assert (names, named) == (
        ["x", "y", "f_cotangent", "g_cotangent"],
        ["x_cotangent", "y_cotangent"],
    )
    F = np.array([[1.0, 2.0], [3.0, 4.0]])
    G = np.array([5.0, 6.0])
    back, of_y = (np.array(v) for v in ca.Function("vjp", given, found)(at, one, F, G))
    assert_allclose(
        back[:, 0], [2 * 2 * 1 + -3 * 2 + 1.5 * 4 + 1.5 * 5, 2 * 2 + 1.5 * 6], rtol=1e-15
    )
    assert_allclose(of_y, 2 * 4 + 2 * 5 - 3 * 6, rtol=1e-15)
    assert [v.shape for v in found] == [(2, 1), (1, 1)]
