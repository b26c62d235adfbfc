"""Start states of segments that the outputs hardly show: a wide prior holds them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.identification.motions import motion_fit as fits
from flexgen.identification.records.description import read_description
from flexgen.identification.records.recording_writer import RecordingWriter
from flexgen.identification.responses.parameters import ParameterVector

MODELS = Path(__file__).resolve().parents[2] / "models"
MAST = """
[[element]]
name = "mast"
body = {{ mass = 50.0, com = [0, 0, 0], inertia = [1.0, 1.0, 1.0] }}

[[element.dof]]
name = "y"
type = "translation"
axis = [{x}, 1.0, 0]
spring = {{ type = "linear", stiffness = 1.0e6 }}
damping = 300.0

"""


@pytest.fixture(scope="module")
def shooting(tmp_path_factory: pytest.TempPathFactory) -> fits.Shooting:
    """The elbow on a mast that moves across its plane, but for a hundred-thousandth."""
    folder = tmp_path_factory.mktemp("mast")
    text = (MODELS / "elbow.toml").read_text(encoding="utf-8")
    at = text.index("# Rotation about +y")
    (folder / "mast.toml").write_text(
        text[:at] + MAST.format(x=1e-5) + text[at:], encoding="utf-8"
    )
    model = flexgen.read(folder / "mast.toml")
    plan = flexgen.excite(model, poses=[[0.5, -0.3]], period_s=1.0, lines=6)
    writer = RecordingWriter(folder, plan, model)
    flexgen.measure(plan, model, raw=writer)
    return fits.Shooting(
        ParameterVector(model, ["q1.stiffness"]), read_description(writer.finish()), 0.05
    )


def test_states_that_no_output_shows_stay(
    shooting: fits.Shooting, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of noisy angles. Without the prior the mast moves a thousand times as far, and takes part in
    the noise.
    """
    first = shooting.z
    y = [c.name for c in shooting.model.coordinates].index("y")
    shooting.y = shooting.y + 1e-3 * np.std(shooting.y) * np.random.default_rng(0).standard_normal(
        shooting.y.shape
    )
    far = []
    for prior in (1e9, fits.FAR):
        monkeypatch.setattr(fits, "FAR", prior)
        shooting.z = first
        r, Jz = shooting.settle(shooting.vector.start)
        far.append(np.abs(shooting.z - first)[:, y].max() / shooting.scale[y])
    assert far[1] < 1e-3 * far[0]
    n_z = shooting.z.shape[1]
    assert r.shape[1] == shooting.y[0].size + n_z == Jz.shape[1]
    assert_allclose(Jz[:, -n_z:], np.broadcast_to(np.eye(n_z) / fits.FAR, (len(Jz), n_z, n_z)))
    prior = (shooting.z - first) / (fits.FAR * shooting.scale)
    assert_allclose(r[:, -n_z:], prior)
    assert_allclose(shooting.errors(r).reshape(len(r), -1), r[:, :-n_z])
