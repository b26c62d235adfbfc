"""Records of the user on the true robot, in the files that flexgen's verbs read.

| file | content | verb |
|---|---|---|
| `rigid.toml` | description of `rigid.csv`: sums of sines | `identify --rigid` |
| `poses.csv` | commanded joints and positions of the ball at rest | `calibrate` |
| `responses_1.toml`, ... | descriptions of multisines, the largest level first | `frf` |
| `tracked.csv` | moves between poses: motor angles and torques, and the ball | |

The tracker has a frame of its own, noise, and in `tracked.csv` a clock of its own: its positions
are those of `offset + (1 + drift) t`. The user knows the drives' sample time and nothing of the
true robot.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.special import betainc

from benchmarks.commissioning.chains import Chain, rotation
from benchmarks.commissioning.plant import Motion, Plant


@dataclass(frozen=True)
class Campaign:
    """Extent of the records, and their noise."""

    poses: int = 60  # static
    noise: float = 3e-5  # m: of each coordinate of the tracker
    spots: int = 3  # poses of the multisines; 0: none are recorded
    levels: tuple[float, ...] = (0.06, 0.03, 0.012)  # rad/s rms of each joint
    period_s: float = 2.0
    periods: int = 4  # the first one is a transient
    band: tuple[float, float] = (1.0, 45.0)  # Hz, of the multisines
    rigid_s: float = 30.0  # s
    tracked: int = 8  # long moves between poses
    speed: float = 1.2  # rad/s: largest of a joint in these moves
    quick: int = 24  # short moves, with accelerations as in the task
    swing: float = 0.3  # rad: largest of a joint in a short move
    lasts: tuple[float, float] = (0.3, 0.6)  # s: of short moves
    every: int = 4  # samples of the drives between two rows
    offset: float = 0.0113  # s, of the tracker's clock
    drift: float = 2e-5  # of the tracker's clock
    torque_noise: float = 0.02  # N m, motor side: of recorded torques


def frame(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Pose of the base in the frame of the tracker: rotation (3, 3) and position (3,) [m]."""
    random = np.random.default_rng(seed + 1000)
    turn = rotation(np.array([0.0, 0.0, 1.0]), random.uniform(-3.0, 3.0))
    tilt = rotation(np.array([1.0, 0.0, 0.0]), random.uniform(-0.02, 0.02))
    return turn @ tilt, random.uniform(-2.0, 2.0, 3)


def seen(ball: np.ndarray, seed: int, noise: float, random: np.random.Generator) -> np.ndarray:
    """Positions (N, 3) [m] in the frame of the tracker, with noise."""
    turn, place = frame(seed)
    return np.asarray(ball @ turn.T + place + noise * random.normal(size=ball.shape))


def inside(chain: Chain, share: float, random: np.random.Generator, count: int) -> np.ndarray:
    """Joints (count, n) [rad], uniform in a share of the ranges."""
    low, high = np.array([axis.range for axis in chain.joints]).T
    middle = 0.5 * (low + high)
    return middle + 0.5 * share * (high - low) * random.uniform(-1, 1, (count, len(low)))


def write_table(file: Path, names: Sequence[str], columns: np.ndarray) -> None:
    """A CSV file with a header; nan is an empty cell."""
    lines = [",".join(names)]
    for row in columns:
        lines.append(",".join("" if np.isnan(value) else f"{value:.10g}" for value in row))
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")


def motor_names(n: int) -> list[str]:
    """Columns of time, motor angles and motor torques."""
    return [
        "time s",
        *(f"q_m[m{k}] rad" for k in range(1, n + 1)),
        *(f"tau_m[m{k}] N m" for k in range(1, n + 1)),
    ]


def motor_columns(motion: Motion, campaign: Campaign, random: np.random.Generator) -> np.ndarray:
    """Every few samples of the drives, with the noise of recorded torques."""
    part = slice(None, None, campaign.every)
    torques = motion.torques[part]
    torques = torques + campaign.torque_noise * random.normal(size=torques.shape)
    return np.column_stack([motion.time[part], motion.angles[part], torques])


def smooth_start(time: np.ndarray, rise: float) -> np.ndarray:
    """From 0 to 1 within `rise` [s], smooth."""
    return np.asarray(betainc(4, 4, np.clip(time / rise, 0.0, 1.0)))


def sines(chain: Chain, time: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Joints (N, n) [rad]: sums of sines of 0.1 to 0.8 Hz in 80 % of the ranges."""
    low, high = np.array([axis.range for axis in chain.joints]).T
    rows = []
    for one, other in zip(low, high, strict=True):
        waves = sum(
            random.uniform(0.4, 1.0) / k * np.sin(0.2 * np.pi * k * time + random.uniform(0, 6.28))
            for k in range(1, 9)
        )
        waves = waves / np.abs(waves).max()
        swing = min(0.4 * (other - one), 0.9)
        rows.append(0.5 * (one + other) + swing * waves)
    q = np.column_stack(rows)
    return np.asarray(q[0] + smooth_start(time, 2.0)[:, None] * (q - q[0]))


def moves(
    chain: Chain, campaign: Campaign, sample_s: float, random: np.random.Generator
) -> np.ndarray:
    """Joints (N, n) [rad]: moves between poses with rests of 0.25 s; after each long move some
    short ones, which are as quick as the moves of the task.
    """
    poses = inside(chain, 0.7, random, campaign.tracked + 1)
    stops = [poses[0]]
    times = []
    each = campaign.quick // max(1, campaign.tracked)
    for pose in poses[1:]:
        # 2.2 is the largest slope of betainc(4, 4)
        times.append(max(0.4, 2.2 * np.abs(pose - stops[-1]).max() / campaign.speed))
        stops.append(pose)
        for _ in range(each):
            stops.append(pose + campaign.swing * random.uniform(-1, 1, len(pose)))
            times.append(random.uniform(*campaign.lasts))
    rest = round(0.25 / sample_s)
    parts = [np.repeat(stops[:1], rest, axis=0)]
    for (begin, end), lasts in zip(pairwise(stops), times, strict=True):
        time = sample_s * np.arange(round(lasts / sample_s))
        parts.append(begin + smooth_start(time, lasts)[:, None] * (end - begin))
        parts.append(np.repeat(end[None], rest, axis=0))
    return np.concatenate(parts)


def write_rigid(plant: Plant, folder: Path, campaign: Campaign, seed: int) -> None:
    """`rigid.csv` and its description."""
    random = np.random.default_rng(seed + 1)
    time = plant.hardware.sample_s * np.arange(round(campaign.rigid_s / plant.hardware.sample_s))
    motion = plant.run(plant.ratio * sines(plant.chain, time, random))
    names = motor_names(plant.n)
    write_table(folder / "rigid.csv", names, motor_columns(motion, campaign, random))
    text = description(plant.n, names) + '\n[[recording]]\nfile = "rigid.csv"\n'
    (folder / "rigid.toml").write_text(text, encoding="utf-8")


def description(n: int, names: Sequence[str], head: str = "") -> str:
    """Tables of the channels of a description of records."""
    lines = ['model = "arm.toml"', head, "[time]", f'name = "{names[0]}"', 'unit = "s"']
    for k in range(n):
        lines += ["", "[[angle]]", f'motor = "m{k + 1}"', f'name = "{names[1 + k]}"']
        lines += ['unit = "rad"', 'side = "motor"']
        lines += ["", "[[torque]]", f'motor = "m{k + 1}"', f'name = "{names[1 + n + k]}"']
        lines += ['unit = "N m"', 'side = "motor"']
    return "\n".join(lines) + "\n"


def write_poses(plant: Plant, folder: Path, campaign: Campaign, seed: int) -> None:
    """`poses.csv`: friction at rest is any torque up to that at which a joint moves."""
    random = np.random.default_rng(seed + 2)
    coulomb = np.array([gear.joint_friction.coulomb for gear in plant.chain.gears])
    commands = inside(plant.chain, 0.9, random, campaign.poses)
    ball = np.empty((len(commands), 3))
    for k, q in enumerate(commands):
        plant.rest(plant.ratio * q, coulomb * random.uniform(-1, 1, plant.n))
        ball[k] = plant.positions()[1]
    names = [f"{axis.name}_rad" for axis in plant.chain.joints]
    names += [f"ball_{axis}_m" for axis in "xyz"]
    rows = np.column_stack([commands, seen(ball, seed, campaign.noise, random)])
    write_table(folder / "poses.csv", names, rows)


def write_tracked(plant: Plant, folder: Path, campaign: Campaign, seed: int) -> None:
    """`tracked.csv`: every second row has a position of the ball."""
    random = np.random.default_rng(seed + 3)
    q = moves(plant.chain, campaign, plant.hardware.sample_s, random)
    motion = plant.run(plant.ratio * q)
    rows = motor_columns(motion, campaign, random)
    at = campaign.offset + (1.0 + campaign.drift) * rows[:, 0]
    ball = CubicSpline(motion.time, motion.ball)(np.clip(at, 0.0, motion.time[-1]))
    ball = seen(ball, seed, campaign.noise, random)
    ball[1::2] = np.nan
    names = [*motor_names(plant.n), *(f"ball_{axis} m" for axis in "xyz")]
    write_table(folder / "tracked.csv", names, np.column_stack([rows, ball]))


def multisine(
    plant: Plant, campaign: Campaign, level: float, experiment: int, phases: np.ndarray
) -> np.ndarray:
    """Joints (N, n) [rad] about zero: odd lines of the period, their speeds all alike.

    The phases of the experiments differ by those of a discrete Fourier transform over the motors,
    so that n experiments are orthogonal.
    """
    n = plant.n
    time = plant.hardware.sample_s * np.arange(
        round(campaign.periods * campaign.period_s / plant.hardware.sample_s)
    )
    first, last = (round(f * campaign.period_s) for f in campaign.band)
    lines = np.arange(first + (first + 1) % 2, last + 1, 2)
    amplitude = level * np.sqrt(2.0 / len(lines))  # rad/s, of a line
    q = np.zeros((len(time), n))
    for line, phase in zip(lines, phases, strict=False):
        omega = 2.0 * np.pi * line / campaign.period_s
        for motor in range(n):
            turned = phase[motor] + 2.0 * np.pi * experiment * motor / n
            q[:, motor] += amplitude / omega * np.sin(omega * time + turned)
    return q


def multisine_rows(job: tuple[Plant, np.ndarray, Campaign, int]) -> np.ndarray:
    """The record of one experiment, with the reference in further columns."""
    plant, reference, campaign, seed = job
    motion = plant.run(reference)
    rows = motor_columns(motion, campaign, np.random.default_rng(seed))
    return np.column_stack([rows, reference[:: campaign.every]])


def write_responses(
    plant: Plant, folder: Path, campaign: Campaign, seed: int, workers: int
) -> None:
    """`responses_K.toml` of each level, with one file for each pose and experiment."""
    random = np.random.default_rng(seed + 4)
    spots = inside(plant.chain, 0.6, random, campaign.spots)
    n = plant.n
    names = [
        "time",
        *(f"{kind}{k}" for kind in ("angle", "torque", "reference") for k in range(1, n + 1)),
    ]
    phases = random.uniform(0.0, 2.0 * np.pi, (200, n))
    time = plant.hardware.sample_s * np.arange(
        round(campaign.periods * campaign.period_s / plant.hardware.sample_s)
    )
    jobs = []
    files = []
    for number, level in enumerate(campaign.levels, start=1):
        for spot, q in enumerate(spots):
            for experiment in range(n):
                wave = multisine(plant, campaign, level, experiment, phases)
                wave = wave * smooth_start(time, 0.5 * campaign.period_s)[:, None]
                own = Plant(plant.chain, seed + 100 + len(jobs), plant.hardware)
                jobs.append((own, plant.ratio * (q + wave), campaign, seed + 500 + len(jobs)))
                files.append((number, q, f"responses_{number}_{spot + 1}_{experiment + 1}.npz"))
    for (_, _, file), rows in zip(files, map_jobs(jobs, workers), strict=True):
        arrays = {name: rows[:, k] for k, name in enumerate(names)}
        np.savez_compressed(folder / file, allow_pickle=False, **arrays)
    for number in range(1, len(campaign.levels) + 1):
        head = f"period_s = {campaign.period_s!r}\ntransients = 1\n"
        head += f'hold = "none"\nf_min = {campaign.band[0]!r}\nf_max = {campaign.band[1]!r}\n'
        text = description(n, names, head)
        for k in range(n):
            text += f'\n[[reference]]\nmotor = "m{k + 1}"\nname = "reference{k + 1}"\n'
            text += 'unit = "rad"\nside = "motor"\n'
        for level, q, file in files:
            if level == number:
                pose = ", ".join(repr(float(v)) for v in q)
                text += f'\n[[recording]]\nfile = "{file}"\npose_rad = [{pose}]\n'
        (folder / f"responses_{number}.toml").write_text(text, encoding="utf-8")


def map_jobs(
    jobs: Sequence[tuple[Plant, np.ndarray, Campaign, int]], workers: int
) -> Sequence[np.ndarray]:
    """The records of all experiments, by several processes."""
    if workers <= 1:
        return [multisine_rows(job) for job in jobs]
    chains = [(job[0].chain, job[0].hardware, *job[1:]) for job in jobs]
    with ProcessPoolExecutor(workers) as pool:
        return list(pool.map(fresh_rows, chains))


def fresh_rows(job: tuple) -> np.ndarray:  # type: ignore[type-arg]
    """The record of one experiment in another process, which makes the plant anew."""
    chain, hardware, reference, campaign, seed = job
    return multisine_rows((Plant(chain, seed, hardware), reference, campaign, seed))


def write_records(
    plant: Plant,
    folder: str | Path,
    campaign: Campaign | None = None,
    seed: int = 0,
    workers: int | None = None,
) -> None:
    """All records of a robot into a folder.

    Parameters
    ----------
    plant
        The true robot.
    folder
        Where; it is made. A model file `arm.toml` belongs next to the records.
    campaign
        How much is recorded; default: `Campaign()`.
    seed
        Of poses, motions, noise, and the frame of the tracker.
    workers
        Processes that simulate the multisines; default: the cores, at most 2.

    """
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    plan = campaign or Campaign()
    count = min(os.cpu_count() or 1, 2) if workers is None else workers
    write_rigid(plant, place, plan, seed)
    write_poses(plant, place, plan, seed)
    write_tracked(plant, place, plan, seed)
    if plan.spots:
        write_responses(plant, place, plan, seed, count)


QUICK = replace(Campaign(), poses=20, spots=1, levels=(0.06,), periods=3, rigid_s=8.0, tracked=3)
