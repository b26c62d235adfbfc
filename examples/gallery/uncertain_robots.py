"""Many robots with other springs and loads than their model: python uncertain_robots.py [FOLDER]
[ROBOTS].
"""

import sys
from typing import Any

import numpy as np
from exhibit import Page, exhibit
from linear_loop import largest_outputs, linearize_loop

import flexgen

QUESTION = "How large is the tool error of robots whose springs and load differ from their model?"
LITERATURE = """
Each robot gets the torques of the model and a P-PI feedback of its motors. invert_many finds \
exactly what it would need
instead; the difference disturbs the closed loop. Approximated: this loop is that of the model, \
linearized along its
motion, and continuous. The table compares with simulations of the full equations and a feedback \
at 2 kHz.
"""
# springs +- 10 %, load up to 3 kg
MODEL = "planar5_nmp"
STEP = 2e-3
SOFTER = 0.1
LOAD = 3.0
CHECKED = 24


def show(page: Page) -> None:
    """Largest errors over the load, and their distribution."""
    count = int(sys.argv[2]) if len(sys.argv) > 2 else 10_000
    rng = np.random.default_rng(0)
    robot = flexgen.load(
        flexgen.generate(
            MODEL, "generated/many", parameters=["stiffness", "payload.mass"]
        ).directory
    )
    values = robot.parameters * rng.uniform(1 - SOFTER, 1 + SOFTER, (count, robot.parameters.size))
    values[:, -1] = rng.uniform(0.0, LOAD, count)
    factors = values[:CHECKED] / np.where(robot.parameters > 0, robot.parameters, 1.0)
    names = [*robot.parameter_names[:-1], "payload"]
    plants = {str(k): dict(zip(names, x, strict=True)) for k, x in enumerate(factors.tolist())}
    path = flexgen.plan(MODEL, "line")
    counts = {"n_pre": 10, "n_post": 250, "samples_per_interval": 10}
    y, dy, ddy = (
        path.sample(np.arange(round(path.duration / STEP) + 1) * STEP).y[:, :, k] for k in range(3)
    )
    given = {"y": y, "dy": dy, "ddy": ddy, "period": STEP, "q_start": path.q_start}
    model = robot.invert(**given, **counts)
    run = flexgen.control(MODEL, plants=plants, progress=False)
    loop = linearize_loop(robot, model, run.law, STEP)
    W = robot.jacobian(model.q_a)[:, : dy.shape[1]]

    def largest_error(chunk: Any) -> np.ndarray:
        d = np.concatenate(
            [getattr(model, key) - getattr(chunk, key) for key in ("tau_m", "q_m", "v_m")], axis=2
        )
        return largest_outputs(loop, W, d.transpose(1, 2, 0))

    options = flexgen.InversionOptions(**counts, reduce=largest_error)
    many = robot.invert_many(
        **given, parameters=values, outputs=("tau_m", "q_m", "v_m"), options=options
    )
    errors = 1e6 * many.reduced
    moving = run.reference.time >= run.reference.begin
    simulated = 1e6 * np.array([run.distance(run[name])[moving].max() for name in plants])
    off = np.abs(errors[:CHECKED] - simulated) / simulated
    rows = [[f"{q} %", float(np.nanpercentile(errors, q))] for q in (50, 90, 99, 100)]
    page.table([f"of {count} robots", "largest tool error, um"], rows)
    page.table(
        ["", "mean", "largest"],
        [["error / simulated error - 1", float(off.mean()), float(off.max())]],
    )
    left, right = page.figure().subplots(1, 2)
    cloud = left.scatter(
        values[:, -1],
        errors,
        2,
        values[:, 0] / robot.parameters[0],
        cmap="viridis",
        rasterized=True,
    )
    left.plot(values[:CHECKED, -1], simulated, "k+", label="simulated")
    page.picture.colorbar(cloud, ax=left, label="stiffness of gear q1 / model")
    right.hist(errors, 60)
    left.set(xlabel="load, kg", ylabel="largest tool error, µm")
    left.legend()
    right.set(xlabel="largest tool error, µm", ylabel="robots")


if __name__ == "__main__":
    exhibit(__file__, QUESTION, LITERATURE, show)
