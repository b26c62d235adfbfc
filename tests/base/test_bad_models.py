"""Wrong model files: each is refused with the right file, line and key, and never with another
exception.
"""

import random
import re

import pytest
from bad_models import CASES, GOOD, edited

from flexgen.base.errors import ArgumentError, FlexgenError, ModelError
from flexgen.model.reader import read


def test_good_text_is_read(tmp_path):
    path = tmp_path / "good.toml"
    path.write_text(GOOD)
    model = read(path)
    assert (model.n_m, model.n_g, model.n_e, model.dof) == (3, 3, 3, 7)
    assert [c.name for c in model.coordinates] == [
        "q1",
        "e1",
        "q2",
        "q3",
        "second_y1",
        "second_y2",
    ]
    assert model.eta.tolist() == [[-100, 0, 0], [0, 50, 0.5], [0, 0, 40]]
    assert read(path, "stiff").dof == 6


@pytest.mark.parametrize("case", CASES)
def test_bad_text_is_refused(case, tmp_path):
    edits, key, words = CASES[case]
    text = edited(edits)
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(ModelError) as caught:
        read(path)
    error = caught.value
    place = f"{path}:{error.line}:{error.key}: " if error.line else f"{path}: {error.key}: "
    assert str(error) == f"{place}given {error.given}, expected {error.expected}"
    assert error.key == key or error.key.endswith("." + key)
    said = str(error).removeprefix(place)
    for word in words:
        assert word in said
    lines = text.split("\n")
    marked = [number for number, line in enumerate(lines, 1) if "#!" in line]
    if marked:
        assert error.line == marked[0]
    elif error.line > 0:
        last = key.replace('"', "").split(".")[-1].split("[")[0]
        assert last in lines[error.line - 1] or "nothing" in error.given or key == "file"
    assert "\n" not in str(error)


def test_line_of_an_entry_in_an_inline_table(tmp_path):
    text = GOOD.replace("0.5, 0.01, 0.0, 0.0,\n]", "0.5, 0.01, 0.0, 0.0,\n], rotational_drag = -1")
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(ModelError) as caught:
        read(path)
    assert "rotational_drag = -1" in text.split("\n")[caught.value.line - 1]


def test_crlf_and_odd_strings_do_not_shift_lines(tmp_path):
    odd = (
        'description = """two\nlines # no comment, "quotes" and \\""" inside"""\n'
        + "source = '''three\n''lines''\n[[element]]'''\n"
    )
    text = GOOD.replace('description = "for tests"\n', odd).replace("mass = 10.0", "mass = -10.0")
    line = next(number for number, row in enumerate(text.split("\n"), 1) if "mass = -10.0" in row)
    for name, ending in (("unix", "\n"), ("dos", "\r\n")):
        path = tmp_path / f"{name}.toml"
        path.write_bytes(text.replace("\n", ending).encode())
        with pytest.raises(ModelError) as caught:
            read(path)
        assert (caught.value.line, caught.value.key) == (line, "element.first.body.mass")


def test_error_in_a_variant_names_its_line(tmp_path):
    text = GOOD.replace('{ type = "rigid" } }', '{ type = "rigit" } }')
    path = tmp_path / "bad.toml"
    path.write_text(text)
    read(path)  # the variant is not chosen; only its paths are looked at
    with pytest.raises(ModelError) as caught:
        read(path, "stiff")
    assert caught.value.key == "element.first.dof.q1.gear.type"
    assert '"rigit"' in text.split("\n")[caught.value.line - 1]


def test_file_must_be_readable_text(tmp_path):
    big = tmp_path / "big.toml"
    big.write_text("#" + "\n#" * 600_000)
    with pytest.raises(ModelError, match="more than 1000000 bytes"):
        read(big)
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b'name = "a"\nsource = "\xff\xfe"\n')
    with pytest.raises(
        ModelError, match=r"binary\.toml:2:file: given the byte 0xff, expected text in UTF-8"
    ):
        read(binary)
    empty = tmp_path / "empty.toml"
    empty.write_text("")
    with pytest.raises(ModelError, match=r"empty\.toml:1:"):
        read(empty)
    good = tmp_path / "good.toml"
    good.write_text(GOOD)
    with pytest.raises(
        ModelError,
        match=r"good\.toml, changed by --set or overrides: element: given \[\], expected a list "
        r"of tables, not empty",
    ):
        read(good, overrides={"element": []})
    with pytest.raises(ArgumentError, match="not a file"):
        read(str(tmp_path) + "/")
    for wrong in (
        tmp_path / "none.toml",
        "a\0b.toml",
        "x" * 5000 + ".toml",
        "/dev/zero",
        3,
        None,
        "",
    ):
        with pytest.raises(ArgumentError):
            read(wrong)


WORDS = [
    "-1",
    "0",
    "1e400",
    "nan",
    '"x"',
    "[]",
    "{}",
    "true",
    "[[1]]",
    "[1, 2]",
    "1979-05-27",
    "",
    "=",
    ".",
    '"',
    "]",
    "q1",
]


@pytest.mark.parametrize("seed", range(300))
def test_mutations_raise_nothing_else(seed, tmp_path):
    rng = random.Random(seed)
    tokens = re.findall(r"\s+|\w+|[^\w\s]", GOOD)
    places = [i for i, token in enumerate(tokens) if not token.isspace()]
    at = rng.choice(places)
    how = rng.randrange(4)
    if how == 0:
        del tokens[at]
    elif how == 1:
        tokens[at] = rng.choice(WORDS)
    elif how == 2:
        tokens.insert(at, tokens[at])
    else:
        tokens[at] = tokens[rng.choice(places)]
    path = tmp_path / "mutant.toml"
    path.write_text("".join(tokens))
    for variant in (None, "stiff"):
        try:
            read(path, variant)
        except FlexgenError as error:
            assert not isinstance(error, ModelError) or 0 <= error.line <= GOOD.count("\n") + 1
