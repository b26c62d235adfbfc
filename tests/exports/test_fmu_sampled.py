"""FMUs of the feedforward and of a controller: the bits of the stream and of the cascade, and
planted errors.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from time import perf_counter

import fmus
import numpy as np
import pytest
import remembering
from clib_planted import plant_in_c

import flexgen
from flexgen.exports.fmu.variables import INPUT, OUTPUT
from flexgen.feedback.loop.interface import Measurement, Reference

VERSIONS = ["2.0", pytest.param("3.0", marks=pytest.mark.slow)]


def smooth(t, length):
    """A polynomial from 0 to 1 with its first two derivatives, at rest at both ends."""
    s = np.clip(t / length, 0.0, 1.0)
    p = s**6 * (462 + s * (-1980 + s * (3465 + s * (-3080 + s * (1386 - 252 * s)))))
    d = 2772 * (s * (1 - s)) ** 5 / length
    return p, d, 13860 * (s * (1 - s)) ** 4 * (1 - 2 * s) / length**2


@cache
def stream_of(model):
    """The library with the payload as parameter, as in the FMU."""
    return flexgen.load(
        flexgen.generate(
            model, fmus.folder() / f"{model}_library", parameters=["payload"]
        ).directory
    )


def path(written, n, period):
    """Samples of the path: (n, n_u)."""
    u = np.tile(fmus.starts(written, INPUT), (n, 1))
    n_y = u.shape[1] // 3
    way = np.array([-0.1, 0.08, 0.0][:n_y])
    for k in range(n):
        p, d, dd = smooth((k + 1) * period, 0.15)
        u[k] += np.concatenate([way * p, way * d, way * dd])
    return u


def streamed(written, u, period=5e-3, samples=5):
    """Outputs of the FMU in each sample, (n samples, n_y)."""
    fmu = fmus.Instance(written)
    y = []
    for k in range(len(u) * samples):
        fmu.put(fmus.references(written, INPUT), u[k // samples])
        fmu.step(k, period / samples)
        y.append(fmu.get(fmus.references(written, OUTPUT)))
    fmu.close()
    return np.array(y)


def stream_bits(model, written, u, begin=None):
    """Torques, angles and speeds of motors, arm coordinates and speeds, residuals, by the stream
    of the library.
    """
    begin = fmus.starts(written, INPUT) if begin is None else begin
    robot = flexgen.read(model)
    start = fmus.starts(written, OUTPUT)
    n_y = robot.output.size
    first = 3 * robot.n_m
    options = {"period": 5e-3, "intervals": 10, "samples_per_interval": 5}
    stream = stream_of(model).stream(begin[:n_y], start[first : first + robot.n_a], **options)
    rows = []
    for row in u:
        found = stream.update(row[:n_y], row[n_y : 2 * n_y], row[2 * n_y :])
        names = ("tau_m", "q_m", "v_m", "q_a", "v_a")
        rows.append(
            np.hstack([*(getattr(found, name) for name in names), np.full((5, 1), found.residual)])
        )
    return np.concatenate(rows)


@pytest.mark.slow
@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("model", ["planar5_nmp", "four_mass", "elbow"])
def test_the_feedforward_gives_the_bits_of_the_stream(model, version):
    written = fmus.exported(model, version, "feedforward")
    u = path(written, 45, 5e-3)
    found = streamed(written, u)
    expected = stream_bits(model, written, u)
    assert np.array_equal(found[:, : expected.shape[1]], expected)
    assert np.abs(np.diff(found[:, 0])).max() > 1e-3  # (it moves)
    late = np.vstack([u[:1], u[:-1]])  # planted: each sample one update late
    assert not np.array_equal(streamed(written, late)[:, : expected.shape[1]], expected)


@pytest.mark.slow
@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_gears_and_motors_with_memory_have_the_torques_of_solve(version, tmp_path):
    """A second instance begins without torques of hysteresis and bristles; what a sample forgets
    is seen.
    """
    model = remembering.remembering()
    given = np.hstack(remembering.samples())

    def torques(forgets):
        with pytest.MonkeyPatch.context() as patch:
            if forgets:
                plant_in_c(patch, *remembering.FORGETS[forgets])
            written = flexgen.export_fmu(
                model, tmp_path / f"a{forgets}.fmu", block="feedforward", version=version
            )
        found, again = (streamed(written, given)[:, :2] for _ in range(2))
        assert np.array_equal(found, again)
        return found

    remembering.check(torques)


@pytest.mark.slow
@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_the_feedforward_in_model_exchange_has_the_same_bits(version):
    """Time events are the samples; inputs are those at the events."""
    written = fmus.exported("planar5_nmp", version, "feedforward")
    u = path(written, 12, 5e-3)
    fmu = fmus.Instance(
        written, "ModelExchange", start=dict(zip(names_of(written, INPUT), u[0], strict=True))
    )
    update = fmu.fmu.newDiscreteStates if version == "2.0" else fmu.fmu.updateDiscreteStates
    rows = [fmu.get(fmus.references(written, OUTPUT))]
    for k in range(1, 60):
        assert fmu.events[4] and fmu.events[5] == pytest.approx(k * 1e-3, rel=1e-12)
        fmu.fmu.setTime(fmu.events[5])
        fmu.fmu.enterEventMode()
        fmu.put(fmus.references(written, INPUT), u[k // 5])
        fmu.events = update()
        fmu.fmu.enterContinuousTimeMode()
        rows.append(fmu.get(fmus.references(written, OUTPUT)))
    fmu.close()
    # the first sample was an input before the initialization: the stream begins there
    expected = stream_bits("planar5_nmp", written, u, u[0])
    assert np.array_equal(np.array(rows)[:, : expected.shape[1]], expected)


def names_of(written, kind):
    return [v.name for v in written.details["variables"] if v.kind == kind]


@pytest.mark.slow
def test_a_sample_out_of_reach_is_refused_and_changes_nothing():
    written = fmus.exported("planar5_nmp", "2.0", "feedforward")
    u = path(written, 6, 5e-3)
    whole = streamed(written, u)
    fmu = fmus.Instance(written)
    inputs = fmus.references(written, INPUT)
    outputs = fmus.references(written, OUTPUT)
    for k in range(30):
        if k == 15:
            fmu.put(inputs, u[k // 5] + np.array([100.0, 0, 0, 0, 0, 0]))
            with pytest.raises(Exception, match="status"):
                fmu.step(k)
        fmu.put(inputs, u[k // 5])
        fmu.step(k)
        assert np.array_equal(fmu.get(outputs), whole[k])
    fmu.close()


@pytest.mark.slow
def test_plant_and_feedforward_track_the_path():
    """Torques of one FMU to the other, a millisecond each: the tool is on the path, but for the
    held torque.
    """
    plant = fmus.exported("planar5_nmp", "2.0")
    ahead = fmus.exported("planar5_nmp", "2.0", "feedforward")
    u = path(ahead, 60, 5e-3)
    # m: a torque that is held for a millisecond lags by half of it; the tool moves at up to 2.3
    # m/s
    errors = [tool_error(plant, ahead, u, True, late) for late in (0.0, 0.5e-3)]
    assert errors[0] < 1.2e-3 and errors[1] < 0.1 * errors[0], errors
    assert tool_error(plant, ahead, u, False, 0.5e-3) > 0.05  # with the torque of the start


def tool_error(plant, ahead, u, used, late):
    """Largest distance of the tool from the path, which is ``late`` [s], in m."""
    robot = fmus.Instance(plant)
    drive = fmus.Instance(ahead)
    torques = fmus.references(plant, INPUT)[:2]
    tool = fmus.references(plant, OUTPUT)[4:6]
    away = []
    for k in range(300):
        drive.put(fmus.references(ahead, INPUT), u[k // 5])
        drive.step(k)
        if used:
            robot.put(torques, drive.get(fmus.references(ahead, OUTPUT)[:2]))
        robot.step(k)
        p, _, _ = smooth((k + 1) * 1e-3 - 0.045 - late, 0.15)
        away.append(np.hypot(*(robot.get(tool) - u[0][:2] - p * np.array([-0.1, 0.08]))))
    robot.close()
    drive.close()
    return max(away)


# --- controller ----------------------------------------------------------------------------------


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])
def test_the_controller_has_the_bits_of_the_cascade(kind, version):
    """Against the cascade in Python; with a planted gain they differ."""
    written = fmus.exported("planar5_nmp", version, "controller")
    rng = np.random.default_rng(3)
    start = fmus.starts(written, INPUT)
    u = start + 0.3 * rng.standard_normal((40, 6))
    expected = cascade_bits(start, u, fmus.cascade(2))
    assert np.array_equal(controlled(written, u, kind, version), expected)
    other = fmus.cascade(2)
    planted = flexgen.Cascade(
        other.position_gain * (1 + 1e-12),
        other.speed_gain,
        other.integral_gain,
        other.filters,
        other.torque_max,
    )
    assert not np.array_equal(cascade_bits(start, u, planted), expected)


def cascade_bits(start, u, cascade):
    """Torques (n, n_m), with the measured angles at first as at the start."""
    cascade.begin(1e-3)
    cascade.reset()
    none = np.zeros(0)

    def step(k, row):
        return cascade.step(
            k, Measurement(row[:2], none), Reference(row[2:4], none, row[4:], none, none, none)
        )

    # a first step at rest leaves the state at rest
    step(0, np.concatenate([start[:2], start[:2], np.zeros(2)]))
    return np.array([step(k, row) for k, row in enumerate(u)])


def controlled(written, u, kind, version):
    inputs = fmus.references(written, INPUT)
    outputs = fmus.references(written, OUTPUT)
    fmu = fmus.Instance(written, kind)
    rows = []
    if kind == "CoSimulation":
        for k, row in enumerate(u):
            fmu.put(inputs, row)
            fmu.step(k)
            rows.append(fmu.get(outputs))
    else:
        fmu.close()
        fmu = fmus.Instance(written, kind, hold_first=True)
        update = fmu.fmu.newDiscreteStates if version == "2.0" else fmu.fmu.updateDiscreteStates
        for k, row in enumerate(u):
            fmu.fmu.setTime(k * 1e-3)
            if k:
                fmu.fmu.enterEventMode()
            fmu.put(inputs, row)
            update()
            fmu.fmu.enterContinuousTimeMode()
            rows.append(fmu.get(outputs))
    fmu.close()
    return np.array(rows)


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize(
    "block", ["controller", pytest.param("feedforward", marks=pytest.mark.slow)]
)
def test_a_step_of_more_samples_than_can_be_computed_is_discarded_at_once(block, version):
    """1e9 s are 1e12 samples: days of computation."""
    written = fmus.exported("elbow", version, block)
    fmu = fmus.Instance(written)
    fmu.step(0, 1e-3)
    before = fmu.get(fmus.references(written, OUTPUT))
    began = perf_counter()
    with pytest.raises(Exception, match=r"status 2|iscard"):
        fmu.fmu.doStep(1e-3, 1e9)
    assert perf_counter() - began < 1.0
    assert np.array_equal(fmu.get(fmus.references(written, OUTPUT)), before)
    fmu.step(1, 1e-3)  # and it continues
    fmu.close()


# --- positions to send ---------------------------------------------------------------------------


FILTERS = "notch = [{ frequency_hz = 60.0 }]\nlow_pass = [{ frequency_hz = 400.0 }]\n"


@pytest.mark.parametrize(
    ("integral", "filters"),
    [
        (6.0, ""),
        *(
            pytest.param(x, text, marks=pytest.mark.slow)
            for x, text in ((0.0, ""), (6.0, FILTERS))
        ),
    ],
)
def test_the_feedforward_of_a_robot_with_a_servo_gives_its_commands(integral, filters, tmp_path):
    """The bits of the stream of a library with positions; planted: each sample one update late."""
    table = "\n[servo]\ntype = 'cascade'\nposition_gain = [30.0, 25.0]\nspeed_gain = [1.5, 0.4]\n"
    table += f"integral_gain = [{integral}, 6.0]\n"
    file = tmp_path / "robot.toml"
    file.write_text(
        Path(flexgen.read("elbow").file).read_text() + table + "delay = 0.0005\n" + filters
    )
    written = flexgen.export_fmu(file, tmp_path / "elbow.fmu", block="feedforward")
    library = flexgen.generate(
        file, tmp_path / "library", parameters=["payload"], parts=["position"]
    ).directory
    robot = flexgen.read(file)
    start = fmus.starts(written, OUTPUT)
    begin = fmus.starts(written, INPUT)
    options = {"period": 5e-3, "intervals": 10, "samples_per_interval": 10, "servo": True}
    stream = flexgen.load(library).stream(begin[:2], start[6 : 6 + robot.n_a], **options)
    u = path(written, 45, 5e-3)
    expected = [stream.update(row[:2], row[2:4], row[4:]) for row in u]
    found = streamed(written, u, samples=10)
    names = [v.name for v in written.details["variables"] if v.kind == OUTPUT]
    at = [names.index(f"arm.{joint}.command") for joint in ("q1", "q2")]
    assert np.array_equal(found[:, at], np.vstack([x.command_g for x in expected]))
    assert np.array_equal(found[:, :2], np.vstack([x.tau_m for x in expected]))
    np.testing.assert_allclose(found[0, at], np.array(start)[at], atol=1e-6)
    assert np.abs(np.diff(found[:, at[0]])).max() > 1e-5
    late = streamed(written, np.vstack([u[:1], u[:-1]]), samples=10)
    assert not np.array_equal(late[:, at], found[:, at])
