"""Helps, completion scripts, public names and printed results are those of `tests/golden/face`."""

from __future__ import annotations

import sys

import pytest
from public_face import FOLDER, TEXTS

OTHER_HELPS = (3, 13)  # argparse of this Python and later ones wraps some helps otherwise


@pytest.mark.parametrize("name", TEXTS)
def test_public_text_is_that_of_the_repository(name):
    """``make golden`` writes them again; read the difference before you commit it."""
    if sys.version_info >= OTHER_HELPS and name == "helps":
        pytest.skip("helps are compared with Python 3.11 and 3.12")
    assert TEXTS[name]() == (FOLDER / f"{name}.txt").read_text(encoding="utf-8"), (
        "run: make golden"
    )
