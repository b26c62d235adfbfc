"""The controllers of the sampled loop: Python, C and plug-ins agree bit by bit, and one that
misbehaves is an error.
"""

from __future__ import annotations

import gc
import subprocess
import threading
import time
import weakref
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from closed_loops import T, loop_of, moving
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError, BuildError, SolverError
from flexgen.codegen.build.compiler import find_compiler
from flexgen.feedback.loop.controllers import Linear
from flexgen.feedback.loop.hardware import DriveHardware
from flexgen.feedback.loop.interface import HEADER, PlugIn, PythonController
from flexgen.identification.experiments.plan import default_cascade
from flexgen.model.elements import RobotModel
from flexgen.model.position_servo.filters import LowPass, Notch

pytestmark = needs_compiler


class Twin:
    """A controller of this package, by its Python method."""

    def __init__(self, law) -> None:
        self.law = law

    def reset(self) -> None:
        self.law.reset()

    def step(self, k, y, ref):
        return self.law.step(k, y, ref)


def laws(model: RobotModel) -> list:
    n = model.n_m
    rng = np.random.default_rng(0)
    gains = default_cascade(model)
    filtered = replace(
        gains,
        integral_gain=np.full(n, 3.0),
        filters=(LowPass(80.0, 0.7), Notch(30.0, 0.2, 0.8)),
        torque_max=np.full(n, 12.0),
    )
    parts = [0.2 * rng.standard_normal((3, *shape)) for shape in ((4, 4), (4, n), (n, 4), (n, n))]
    return [gains, filtered, Linear(*parts, samples=70)]


@pytest.mark.parametrize("k", range(3))
def test_python_and_c_controllers_give_the_same_bits(k):
    model = flexgen.read("planar5_nmp")
    law = laws(model)[k]
    if hasattr(law, "begin"):
        law.begin(T)
    hardware = DriveHardware(T, encoder_noise_rad=1e-4)
    runs = []
    for controller in (law, PythonController(Twin(law))):
        loop, at_rest, _, _ = loop_of(model, hardware, lanes=2, controller=controller, seed=3)
        runs.append(loop.run(moving(at_rest, 2, 400, 0.2), 400))
    assert np.array_equal(runs[0].tau_m, runs[1].tau_m) and np.array_equal(
        runs[0].q_m, runs[1].q_m
    )


def test_filters_have_their_frequency_responses():
    """Sections at some frequencies against the continuous filter, its frequency axis bent by the
    bilinear transform.
    """
    for f, b, a in (
        (LowPass(50.0, 0.6), lambda s: 1.0, lambda s: s * s + 1.2 * s + 1),
        (Notch(40.0, 0.1, 0.5), lambda s: s * s + 0.2 * s + 1, lambda s: s * s + 1.0 * s + 1),
    ):
        b0, b1, b2, a1, a2 = f.section(T)
        for hz in (1.0, 20.0, f.frequency_hz, 200.0):
            z = np.exp(-2j * np.pi * hz * T)
            s = 1j * np.tan(np.pi * hz * T) / np.tan(np.pi * f.frequency_hz * T)
            assert (b0 + b1 * z + b2 * z * z) / (1 + a1 * z + a2 * z * z) == pytest.approx(
                b(s) / a(s), rel=1e-9
            )
    with pytest.raises(ArgumentError, match="half the sample rate"):
        LowPass(1000.0).section(T)


BAD = {
    "raises": ("raise ValueError('no')", "step 3 raised ValueError: no"),
    "NaN": ("return u * np.nan", "expected finite torques"),
    "size": ("return np.zeros(5)", r"returned shape \(5,\), expected \(2,\)"),
    "text": ("return 'much'", "raised ValueError"),
}


@pytest.mark.parametrize("name", BAD)
def test_controllers_that_misbehave_end_with_a_sentence(name):
    body, words = BAD[name]
    namespace = {"np": np}
    exec(f"def act(u):\n    {body}\n", namespace)

    class Bad:
        def reset(self):
            pass

        def step(self, k, y, ref):
            return namespace["act"](ref.tau_m) if k == 3 else ref.tau_m

    loop, at_rest, _, _ = loop_of(
        flexgen.read("planar5_nmp"), DriveHardware(T), controller=PythonController(Bad())
    )
    with pytest.raises(SolverError, match=words):
        loop.run(at_rest[None], 10)


def test_ctrl_c_in_a_controller_ends_the_run():
    class Interrupted:
        def reset(self):
            pass

        def step(self, k, y, ref):
            raise KeyboardInterrupt

    loop, at_rest, _, _ = loop_of(
        flexgen.read("planar5_nmp"), DriveHardware(T), controller=PythonController(Interrupted())
    )
    with pytest.raises(KeyboardInterrupt):
        loop.run(at_rest[None], 10, check=False)


def test_objects_without_the_interface_are_refused():
    with pytest.raises(ArgumentError, match="without reset"):
        PythonController(object())


class AsPlugIn:
    """Python version of the plug-in controller of the examples."""

    def reset(self) -> None:
        self.q = None

    def step(self, k, y, ref):
        q, q_ref = (ref.q_m, ref.q_m) if self.q is None else self.q
        self.q = y.q_m.copy(), ref.q_m.copy()
        return (
            ref.tau_m + 20.0 * (ref.q_m - y.q_m) + 0.5 * ((ref.q_m - q_ref) / T - (y.q_m - q) / T)
        )


EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "controller_plugin.c"


def plug_in(
    folder: Path, abi: str = "FLEXGEN_CONTROLLER_ABI", reset: str = "setup->n_m > MOTORS"
) -> Path:
    """The example as a shared library, with another version or another result of its reset."""
    source = folder / "mine.c"
    made = folder / f"mine{len(abi)}{len(reset)}.so"
    text = EXAMPLE.read_text().replace("return FLEXGEN_CONTROLLER_ABI;", f"return {abi};")
    source.write_text(text.replace("setup->n_m > MOTORS", reset))
    flags = [
        "-O2",
        "-ffp-contract=off",
        "-shared",
        "-fPIC",
        f"-I{HEADER.parent}",
        "-Wall",
        "-Wextra",
        "-Werror",
    ]
    subprocess.run([*find_compiler().command, *flags, "-o", str(made), str(source)], check=True)
    return made


def test_a_plug_in_gives_the_bits_of_its_python_twin(tmp_path):
    model = flexgen.read("planar5_nmp")
    runs = []
    for controller in (PlugIn(plug_in(tmp_path)), PythonController(AsPlugIn())):
        loop, at_rest, _, _ = loop_of(model, DriveHardware(T), lanes=3, controller=controller)
        runs.append(loop.run(moving(at_rest, 2, 200, 0.1), 200).tau_m)
    assert np.array_equal(*runs)


def test_a_plug_in_that_does_not_return_ends_the_run(tmp_path, monkeypatch):
    """Its step waits at sample 7 for half a minute; the run ends with a sentence after 0.3 s,
    other loops continue.
    """
    source = tmp_path / "slow.c"
    made = tmp_path / "slow.so"
    text = EXAMPLE.read_text().replace("(void)k;", "if (k == 7) sleep(30);")
    source.write_text(f"#include <unistd.h>\n{text}")
    flags = ["-O2", "-shared", "-fPIC", f"-I{HEADER.parent}"]
    subprocess.run([*find_compiler().command, *flags, "-o", str(made), str(source)], check=True)
    monkeypatch.setattr("flexgen.feedback.loop.closed_loop.LONGEST_STEP_S", 0.3)
    loop, at_rest, _, _ = loop_of(
        flexgen.read("planar5_nmp"), DriveHardware(T), controller=PlugIn(made)
    )
    with pytest.raises(SolverError, match=r"has not returned from its step 7 for 0.3 s"):
        loop.run(moving(at_rest, 2, 20, 0.1), 20)
    good, at_rest, _, _ = loop_of(
        flexgen.read("planar5_nmp"), DriveHardware(T), controller=PlugIn(plug_in(tmp_path))
    )
    assert np.isfinite(good.run(moving(at_rest, 2, 20, 0.1), 20).tau_m).all()


@pytest.mark.slow
def test_an_interrupted_plug_in_has_its_arrays_and_stops(tmp_path, monkeypatch):
    """Ctrl-C in a step of 2 s: the arrays are not freed before the thread has ended, which it does
    after the step.
    """
    source = tmp_path / "slow.c"
    made = tmp_path / "slow.so"
    source.write_text(
        "#include <unistd.h>\n"
        f"{EXAMPLE.read_text().replace('(void)k;', 'usleep(2000000 + 0 * (unsigned)k);')}"
    )
    flags = ["-O2", "-shared", "-fPIC", f"-I{HEADER.parent}"]
    subprocess.run([*find_compiler().command, *flags, "-o", str(made), str(source)], check=True)
    loop, at_rest, _, _ = loop_of(
        flexgen.read("planar5_nmp"), DriveHardware(T), controller=PlugIn(made)
    )
    reference = np.ascontiguousarray(moving(at_rest, 2, 20, 0.1), dtype=float)
    freed = weakref.finalize(reference, lambda: None)
    polls = iter(range(100))
    before = set(threading.enumerate())

    def interrupted(self, timeout=None):
        if next(polls) == 2:
            raise KeyboardInterrupt
        time.sleep(0.05)

    with monkeypatch.context() as patch:
        patch.setattr("threading.Thread.join", interrupted)
        with pytest.raises(KeyboardInterrupt):
            loop.run(reference, 60_000)
    (thread,) = set(threading.enumerate()) - before
    del reference
    gc.collect()
    assert freed.alive  # the thread has it
    thread.join(20.0)
    assert not thread.is_alive()  # it stopped after a sample, not after 60,000
    del loop, thread
    gc.collect()
    assert not freed.alive


@pytest.mark.slow
def test_plug_ins_of_another_version_or_without_functions_are_refused(tmp_path):
    with pytest.raises(
        BuildError, match="given version 9 of the interface of controllers, expected 1"
    ):
        PlugIn(plug_in(tmp_path, abi="9"))
    refusing = PlugIn(plug_in(tmp_path, reset="setup->n_m > 1"))
    with pytest.raises(ArgumentError, match="its reset refused the robot with status 1"):
        loop_of(flexgen.read("planar5_nmp"), DriveHardware(T), controller=refusing)
    with pytest.raises(BuildError, match="given no shared library"):
        PlugIn(tmp_path / "mine.c")
    empty = tmp_path / "empty.so"
    subprocess.run(
        [*find_compiler().command, "-shared", "-fPIC", "-x", "c", "-o", str(empty), "/dev/null"],
        check=True,
    )
    with pytest.raises(BuildError, match="given no function flexgen_controller_abi"):
        PlugIn(empty)
