"""Memory of streams: that of another robot, of another stream, or a part of it is refused in every
call.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.runtime.streams.stream import Stream, stream_again

PERIOD = 0.005  # s
START = flexgen.plan("elbow", "line").sample([0.0]).y[0, :, 0]
FREE = np.full(2, 1e6)  # N m, rad/s: limits that nothing reaches


def at_rest(library: flexgen.Library, intervals: int = 20, samples: int = 1) -> Stream:
    return library.stream(
        START,
        flexgen.plan("elbow", "line").q_start,
        period=PERIOD,
        intervals=intervals,
        samples_per_interval=samples,
    )


@pytest.fixture(scope="module")
def libraries(tmp_path_factory: pytest.TempPathFactory) -> dict[str, flexgen.Library]:
    """Of the elbow, and of a robot with its name, sizes and functions, and another mass."""
    folder = tmp_path_factory.mktemp("libraries")
    text = (Path(__file__).parents[2] / "models" / "elbow.toml").read_text(encoding="utf-8")
    heavier = text.replace("mass = 190.25", "mass = 200.25")
    assert heavier != text
    files = {"elbow": text, "heavier": heavier}
    out = {}
    for name, content in files.items():
        (folder / name).mkdir()
        model = folder / name / "elbow.toml"
        model.write_text(content, encoding="utf-8")
        options: dict[str, Any] = {"parameters": ["payload.mass"], "parts": ["force"]}
        out[name] = flexgen.load(
            flexgen.generate(model, folder / f"{name}_c", **options).directory
        )
    return out


def memory_of(stream: Stream) -> np.ndarray:
    """The memory of a stream as it is pickled."""
    _, (*_, memory) = stream.__reduce__()
    return memory


def on(memory: np.ndarray, stream: Stream) -> Stream:
    """The stream as it is made from a pickle, with this memory."""
    _, (*others, _) = stream.__reduce__()
    return stream_again(*others, memory)


def calls_of(stream: Stream, library: flexgen.Library) -> dict[str, Callable[[], Any]]:
    return {
        "update": lambda: stream.update(START, np.zeros(2), np.zeros(2)),
        "limit": lambda: stream.limit(torque=FREE, speed=FREE),
        "parameters": lambda: stream.set_parameters(library.parameters),
        "force": lambda: stream.set_force(np.zeros(6)),
    }


@needs_compiler
def test_its_own_memory_is_taken(libraries: dict[str, flexgen.Library]) -> None:
    library = libraries["elbow"]
    stream = at_rest(library)
    for call in calls_of(on(memory_of(stream), stream), library).values():
        call()


@needs_compiler
def test_memory_of_another_robot_is_refused(libraries: dict[str, flexgen.Library]) -> None:
    stream, other = (at_rest(libraries[name]) for name in ("elbow", "heavier"))
    assert memory_of(stream).size == memory_of(other).size
    for call in calls_of(on(memory_of(other), stream), libraries["elbow"]).values():
        with pytest.raises(ArgumentError, match="not started by this library"):
            call()


@needs_compiler
@pytest.mark.parametrize("kept", [-1, 5000, 24])
def test_a_part_of_its_memory_is_refused(libraries: dict[str, flexgen.Library], kept: int) -> None:
    stream = at_rest(libraries["elbow"])
    memory = memory_of(stream)
    assert memory.size > kept
    for call in calls_of(on(memory[:kept], stream), libraries["elbow"]).values():
        with pytest.raises(ArgumentError, match="workspace is too small"):
            call()


@needs_compiler
def test_memory_of_a_stream_of_other_sizes_is_refused(
    libraries: dict[str, flexgen.Library],
) -> None:
    stream = at_rest(libraries["elbow"])
    for sizes in ({"intervals": 21}, {"samples": 4}):
        other = at_rest(libraries["elbow"], **sizes)
        with pytest.raises(ArgumentError, match="memory of another stream"):
            on(memory_of(other), stream)


@needs_compiler
@pytest.mark.parametrize("power", [270, 294, 303])
def test_no_result_with_an_infinite_number_in_its_info(
    libraries: dict[str, flexgen.Library], power: int
) -> None:
    """A force near the largest number [N]: the step of the output had no bound, with the status
    OK.
    """
    stream = at_rest(libraries["elbow"])
    stream.set_force(np.array([10.0**power, 0.0, 0.0, 0.0, 0.0, 0.0]))
    with pytest.raises(SolverError, match="not finite"):
        for _ in range(40):
            found = stream.update(START, np.zeros(2), np.zeros(2))
            infinite = [x for x in vars(found).values() if isinstance(x, float) and np.isinf(x)]
            assert not (found.converged and infinite)
