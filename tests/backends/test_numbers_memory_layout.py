"""Arrays on a card without one, axes of batches, files of forces and of robots: layouts and
messages by hand.
"""

from __future__ import annotations

import ctypes
from pathlib import Path
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from flexgen.backends.autodiff import points
from flexgen.backends.cuda.arrays import DeviceArray, Given, steps_of, stream_handle
from flexgen.base.errors import ArgumentError
from flexgen.base.spec.ports import Port
from flexgen.model.urdf import urdf_source
from flexgen.paths.force import force_files


# --- arrays on the GPU ---------------------------------------------------------------------------
class Card:
    """Memory of the CPU in place of a card, as number 2; other addresses are of card 3."""

    ordinal = 2

    def __init__(self) -> None:
        self.memory: dict[int, np.ndarray] = {}
        self.waited: list[tuple[int, int]] = []
        self.freed: list[tuple[int, int]] = []

    def allocate(self, size: int, stream: int) -> int:
        made = np.zeros(size, np.uint8)
        self.memory[made.ctypes.data] = made
        return int(made.ctypes.data)

    def free(self, address: int, stream: int) -> None:
        self.freed.append((address, stream))

    def read(self, address: int, to: int, size: int, stream: int) -> None:

        ctypes.memmove(to, address, size)

    def wait(self, handle: int, other: int) -> None:
        self.waited.append((handle, other))

    def ordinal_of(self, address: int) -> int | None:
        return self.ordinal if address in self.memory else 3 if address else None


@pytest.mark.parametrize("shape", [(), (5,), (4, 3), (2, 3, 4)])
@pytest.mark.parametrize("order", ["C", "F"])
def test_arrays_on_the_card_are_laid_out_as_numpy_does(shape: tuple[int, ...], order: Any) -> None:
    card: Any = Card()
    x = np.asarray(np.arange(np.prod(shape)).reshape(shape), dtype=np.float32, order=order)
    assert steps_of(shape, 4, order) == x.strides
    made = DeviceArray.empty(card, shape, x.dtype, 7, order)
    (memory,) = card.memory.values()
    assert memory.nbytes == x.nbytes and made.strides == x.strides
    memory[:] = np.frombuffer(x.tobytes(order), np.uint8)
    assert_array_equal(made.numpy(), x)
    assert made.T.shape == shape[::-1] and made.T.strides == x.T.strides
    assert_array_equal(made.T.numpy(), x.T)
    told = made.__cuda_array_interface__
    assert (told["shape"], told["strides"], told["typestr"], told["version"]) == (
        shape,
        x.strides,
        "<f4",
        3,
    )
    assert told["data"] == (memory.ctypes.data, False) and told["stream"] == 7
    assert made.__dlpack_device__() == (2, 2)
    assert repr(made) == f"<DeviceArray {shape}, float32, cuda:2>"
    at = memory.ctypes.data
    del made
    assert card.freed == [(at, 7)]


def test_streams_are_handles_or_objects_that_have_one() -> None:
    assert [stream_handle("f", x) for x in (None, 0, 9)] == [0, 0, 9]
    assert stream_handle("f", Made(cuda_stream=5)) == 5 and stream_handle("f", Made(ptr=6)) == 6
    assert stream_handle("f", Made(__cuda_stream__=lambda: (0, 8))) == 8
    assert stream_handle("f", Made(__cuda_stream__=(0, 4))) == 4
    for bad in (True, -1, "s", 1.0, Made(ptr=-3)):
        with pytest.raises(
            ArgumentError,
            match=r"^f, stream: given .*, expected a stream of CuPy, PyTorch or cuda",
        ):
            stream_handle("f", bad)
    card: Any = Card()
    assert (
        DeviceArray(card, 1, (), (), np.dtype(float), None).__cuda_array_interface__["stream"] == 1
    )


def test_an_array_is_given_to_others_when_its_stream_is_done() -> None:
    card: Any = Card()
    made = DeviceArray.empty(card, (2,), np.dtype(float), 7)
    for stream, waits in ((7, []), (-1, []), (9, [(9, 7)]), (None, [(0, 7)]), (1, [(0, 7)])):
        card.waited.clear()
        made.__dlpack__(stream=stream)
        assert card.waited == waits
    made.__dlpack__(stream=7, copy=False, dl_device=(2, 2))
    with pytest.raises(BufferError, match="given copy=True, expected None or False"):
        made.__dlpack__(copy=True)
    with pytest.raises(BufferError, match=r"given the device \(2, 1\), expected \(2, 2\)"):
        made.__dlpack__(dl_device=(2, 1))


def test_arrays_of_others_are_taken_by_their_interface() -> None:
    card: Any = Card()
    at = card.allocate(48, 0)

    def given(stream: int = 5, **changes: Any) -> Given:
        told = {
            "data": (at, False),
            "shape": (2, 3),
            "typestr": "<f8",
            "strides": None,
            "stream": 5,
        } | changes
        return Given(card, "f", "q", Made(__cuda_array_interface__=told), stream)

    found = given()
    assert (found.address, found.shape, found.strides, found.dtype) == (
        at,
        (2, 3),
        None,
        "<f8",
    ) and not card.waited
    other = {
        "data": (at, False),
        "shape": (2, 3),
        "typestr": "<f8",
        "stream": 1,
        "strides": (8, 16),
    }
    found = Given(card, "f", "q", Made(__cuda_array_interface__=other), 0)
    assert found.strides == (8, 16) and not card.waited  # the default stream, by both of its names
    Given(card, "f", "q", Made(__cuda_array_interface__=other), 4)
    assert card.waited == [(4, 0)]
    given(stream=6)
    assert card.waited[1:] == [(6, 5)]
    given(shape=(0, 3), data=(0, False))  # nothing to read: in no memory
    for changes, text in (
        ({"mask": 1}, "^f, q: given an array with masked entries, expected real numbers$"),
        (
            {"data": (0, False)},
            r"^f, q: given an array in the memory of the CPU, expected one on cuda:2, where the",
        ),
        (
            {"data": (64, False)},
            r"^f, q: given an array in the memory of cuda:3, expected one on cuda:2",
        ),
        ({"strides": (8,)}, r"^f, q: given strides \(8,\) for shape \(2, 3\), expected as many$"),
        (
            {"typestr": None, "data": None},
            r"^f, q: given SimpleNamespace that does not give its memory",
        ),
    ):
        with pytest.raises(ArgumentError, match=text):
            given(**changes)
    for x, text in (
        (
            np.zeros(2),
            "given ndarray on the CPU, expected an array on cuda:2; copy it with library",
        ),
        ([1.0], "given list on the CPU"),
        ("q", "given str, expected an array with __dlpack__ or __cuda_array_interface__"),
    ):
        with pytest.raises(ArgumentError, match=f"^f, q: {text}"):
            Given(card, "f", "q", x, 0)


UNFIT: dict[str, tuple[dict[str, Any], tuple[int | None, ...], str, str]] = {
    "shape": ({"shape": (4, 2)}, (None, 3), "F", r"f, q: given shape \(4, 2\), expected \(N, 3\)"),
    "dimensions": ({"shape": (4,)}, (4, 1), "F", r"given shape \(4,\), expected \(4, 1\)"),
    "precision": (
        {"typestr": "<f4"},
        (None, 3),
        "F",
        "given numbers of type <f4, expected float64; a library has the precision",
    ),
    "rows": (
        {},
        (None, 3),
        "F",
        r"given strides \(24, 8\) of bytes, expected \(8, 32\): the order of Fortran, with",
    ),
    "columns": (
        {"strides": (8, 32)},
        (None, 3),
        "C",
        r"given strides \(8, 32\) of bytes, expected \(24, 8\): rows without gaps",
    ),
}
FIT: dict[str, tuple[dict[str, Any], str]] = {
    "rows": ({}, "C"),
    "columns": ({"strides": (8, 32)}, "F"),
    "one row, in both orders": ({"shape": (1, 3)}, "F"),
    "none": ({"shape": (0, 3)}, "F"),
}


def array_of_others(**changes: Any) -> Given:
    """An array (4, 3) of float64 in the order of C on a card."""
    card: Any = Card()
    at = card.allocate(96, 0)
    told = {"data": (at, False), "shape": (4, 3), "typestr": "<f8", "strides": None} | changes
    return Given(card, "f", "q", Made(__cuda_array_interface__=told), 0)


@pytest.mark.parametrize("name", UNFIT)
def test_arrays_that_do_not_fit_are_refused(name: str) -> None:
    changes, shape, order, text = UNFIT[name]
    with pytest.raises(ArgumentError, match=text):
        array_of_others(**changes).demand(shape, np.dtype("<f8"), order)


@pytest.mark.parametrize("name", FIT)
def test_arrays_that_fit(name: str) -> None:
    """Axes of one entry, and arrays without any, may have any stride."""
    changes, order = FIT[name]
    array_of_others(**changes).demand((None, 3), np.dtype("<f8"), order)


# --- batches -------------------------------------------------------------------------------------
def test_axes_of_a_batch_are_before_those_of_a_point() -> None:
    ports = [Port("q", (2,), "rad", "angles"), Port("R", (3, 3), "1", "rotation")]
    for shapes, lead in (
        (((2,), (3, 3)), ()),
        (((5, 2), (3, 3)), (5,)),
        (((2,), (4, 5, 3, 3)), (4, 5)),
        (((4, 5, 2), (4, 5, 3, 3)), (4, 5)),
    ):
        assert points.lead_of("f", ports, shapes) == lead
    for wrong, text in (
        (((3,), (3, 3)), r"^f, q: given shape \(3,\), expected \(2,\) or \(\.\.\., 2\)$"),
        (((), (3, 3)), r"^f, q: given shape \(\), expected \(2,\) or"),
        (
            ((5, 2), (4, 3, 3)),
            r"^f, R: given shape \(4, 3, 3\), expected \(3, 3\) or \(5, 3, 3\)$",
        ),
        (((5, 2), (3,)), r"^f, R: given shape \(3,\), expected"),
    ):
        with pytest.raises(ArgumentError, match=text):
            points.lead_of("f", ports, wrong)
    text = points._call("batch", 1)
    assert (
        "static int call_batch(void *f, int count, int n, void **a)" in text
        and text.count("case ") == 25
    )
    assert "case 2: return ((int (*)(int, void *, void *))f)(n, a[0], a[1]);" in text
    assert "case 1: return ((int (*)(void *))f)(a[0]);" in points._call("single", 0)


# --- forces --------------------------------------------------------------------------------------
def test_files_of_forces_are_tables_of_numbers(tmp_path: Path) -> None:
    file = tmp_path / "force.csv"

    def read(text: str) -> Any:
        file.write_text(text, encoding="utf-8")
        return force_files.read_force(file, "s", "a file")

    found = read("\ufeffs, fx, fy,fz\n0,1,2,3\n0.5,4,5,6\n")
    assert_allclose(found.time, [0, 0.5])
    assert_allclose(found["force"], [[1, 2, 3], [4, 5, 6]])
    assert found.labels["force"] == ("fx", "fy", "fz")
    found = read("s,fx,fy,fz,mx,my,mz\n0,1,2,3,4,5,6\n1,1,2,3,4,5,7\n")
    assert found["force"].shape == (2, 6) and found.units["force"] == ("N",) * 3 + ("N m",) * 3
    for text, told in (
        (
            "s,fx,fy\n0,1,2\n1,1,2\n",
            "^force: given the columns s, fx, fy in .*, expected the columns s, fx, fy, fz",
        ),
        ("t,fx,fy,fz\n0,1,2,3\n1,1,2,3\n", "^force: given the columns t, fx, fy, fz in"),
        (
            "s,fx,fy,fz,mx\n0,1,2,3,4\n1,1,2,3,4\n",
            "^force: given the columns s, fx, fy, fz, mx in",
        ),
        (
            "s,fx,fy,fz\n0,1,2,3\n",
            r"^force: given 1 rows in .*, expected two or more of 4 numbers$",
        ),
        (
            "s,fx,fy,fz\n0,1,2\n1,1,2\n",
            r"^force: given 2 rows in .*, expected two or more of 4 numbers$",
        ),
        (
            "s,fx,fy,fz\n0,1,2,3\n0,1,2,3\n",
            r"^force: given 0, 1, 2, 3 in row 2 of .*, expected finite numbers, s incr",
        ),
        ("s,fx,fy,fz\n0,1,nan,3\n1,1,2,3\n", "^force: given 0, 1, nan, 3 in row 1 of"),
        (
            "s,fx,fy,fz\n0,1,x,3\n",
            "cannot be read .*, expected names in line 1, then numbers with a decimal point",
        ),
    ):
        with pytest.raises(ArgumentError, match=told):
            read(text)
    with pytest.raises(
        ArgumentError, match=r"^force: file .* cannot be read .*, expected a file$"
    ):
        force_files.read_force(tmp_path / "none.csv", "s", "a file")
    assert force_files.is_table(file) and not force_files.is_table(tmp_path / "none.csv")
    for text, ours in (("# flexgen", False), ("\ufeff# flexgen", False), ("s,fx", True)):
        file.write_text(text, encoding="utf-8")
        assert force_files.is_table(file) is ours
    assert not force_files.is_table(file.rename(tmp_path / "force.txt"))


# --- robots --------------------------------------------------------------------------------------
def test_packages_are_searched_in_the_folders_of_their_variables(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for place in ("ros1/arm", "itself/arm", "ament/share/arm"):
        (tmp_path / place / "urdf").mkdir(parents=True)
    for name, place in (("a", "ros1/arm"), ("b", "itself/arm"), ("c", "ament/share/arm")):
        (tmp_path / place / "urdf" / f"{name}.urdf").write_text(f'<robot name="{name}"/>')
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"{tmp_path / 'ros1'}:{tmp_path / 'itself' / 'arm'}")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path / 'none'}:{tmp_path / 'ament'}")
    for name, place in (("a", "ros1/arm"), ("b", "itself/arm"), ("c", "ament/share/arm")):
        found = urdf_source.locate(f"package://arm/urdf/{name}.urdf", Path("/"))
        assert found == tmp_path / place / "urdf" / f"{name}.urdf"
    for bad in (
        "package://arm/urdf/d.urdf",
        "package://arm",
        "package:///urdf/a.urdf",
        "package://arm/../arm/urdf/a.urdf",
    ):
        assert urdf_source.locate(bad, Path("/")) is None
    assert (
        urdf_source.locate("ros1/arm/urdf/a.urdf", tmp_path) == tmp_path / "ros1/arm/urdf/a.urdf"
    )
    assert (
        urdf_source.locate("ros1/arm", tmp_path) is None
        and urdf_source.locate("a\0b", tmp_path) is None
    )


def test_files_that_a_robot_was_read_from(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.urdf").write_text("<robot/>")
    (tmp_path / "own.toml").write_text("name = 'x'")
    (tmp_path / "over.toml").write_text('[urdf]\nfile = "arm.urdf"')
    (tmp_path / "bad.toml").write_text("[urdf\n")
    names = {
        "": [],
        "none.toml": [],
        "own.toml": ["own.toml"],
        "over.toml": ["over.toml", "arm.urdf"],
    }
    names |= {
        "bad.toml": ["bad.toml"],
        "arm.urdf#base:tip": ["arm.urdf"],
        "arm.urdf": ["arm.urdf"],
    }
    for given, files in names.items():
        assert [path.name for path in urdf_source.source_files(given)] == files
    assert urdf_source.from_here(tmp_path / "own.toml") == "own.toml"
    assert urdf_source.from_here(Path("/usr")) == "/usr"


def test_ends_of_a_plain_file_are_given_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    joint = '<joint name="j" type="fixed"><parent link="base"/><child link="tip"/></joint>'
    (tmp_path / "arm.urdf").write_text(
        f'<robot name="r"><link name="base"/><link name="tip"/>{joint}</robot>'
    )
    for given in (("arm.urdf#base:tip", None, None), ("arm.urdf", "base", "tip")):
        found = urdf_source.plain_urdf(*given)
        assert found is not None and found[1:] == ("arm.urdf", "arm.urdf#base:tip")
    assert (
        urdf_source.plain_urdf(3, None, None) is None
        and urdf_source.plain_urdf("elbow", None, None) is None
    )
    wrong: Any = 3
    for ends, text in (
        (
            ("elbow", "base", None),
            "^base and tip: given with the model 'elbow', expected a .urdf file with them$",
        ),
        (
            ("arm.urdf#base:tip", None, "tip"),
            "^base and tip: given in addition to 'arm.urdf#base:tip', expected each",
        ),
        (("arm.urdf", wrong, "tip"), "^base: given 3, expected the name of a link$"),
        (
            ("none.urdf", "base", "tip"),
            "^model: given 'none.urdf', which is not a file, expected the path of a .urdf",
        ),
        (
            ("package://x/y.urdf", "base", "tip"),
            "^model: given 'package://x/y.urdf', which is not a file below",
        ),
        (
            ("arm.urdf", "base", None),
            r"the two ends .*expected arm\.urdf#BASE:TIP .*, such as .base. and one of .tip.",
        ),
    ):
        with pytest.raises(ArgumentError, match=text):
            urdf_source.plain_urdf(*ends)
