"""Records with one planted fault each: is it named, refused, or fitted in silence?

    python benchmarks/commissioning/faults.py FOLDER [--robot three_axes] [--only WORDS]

draws a true robot and writes its records into FOLDER, plants each fault of `FAULTS` in a copy, and
calls the verb that the pages name for such a record. The verdict is on the text that a user sees:

| verdict | the text |
|---|---|
| named | has the fault |
| refused | has no cause, and the result is not usable: an error, or a status other than success |
| misnamed | has another cause |
| stated | has none, and says that these data do not show the fault up to a limit |
| silent | has none, and the result is a success |

The first row is the record without a fault.
"""

from __future__ import annotations

import argparse
import re
import shutil
import time
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path

import numpy as np

from benchmarks.commissioning.datasheet import write_datasheet
from benchmarks.commissioning.plant import Plant
from benchmarks.commissioning.records import Campaign, write_poses, write_rigid, write_table
from benchmarks.commissioning.robots import NAMES, draw, stated

SEED = 11
CAUSE = re.compile(
    "probably |possible cause: |mistake can be the reason: |tolerances of the datasheet"
)
SHORT = replace(Campaign(), spots=0, rigid_s=15.0)


class Lab:
    """A folder with `arm.toml`, `poses.csv`, `rigid.toml` and `rigid.csv`, to plant a fault in."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def table(self, name: str) -> tuple[list[str], np.ndarray]:
        """Names of the columns, and the columns (N, k), of a CSV file."""
        file = self.folder / name
        names = file.read_text(encoding="utf-8").partition("\n")[0].split(",")
        return names, np.genfromtxt(file, delimiter=",", skip_header=1)

    def change(self, name: str, function: Callable[[np.ndarray], np.ndarray]) -> None:
        """Write the columns of a CSV file anew."""
        names, columns = self.table(name)
        write_table(self.folder / name, names, function(columns))

    @property
    def joints(self) -> int:
        """Motors of the robot."""
        return (len(self.table("rigid.csv")[0]) - 1) // 2

    def edit(self, pattern: str, new: str) -> None:
        """Replace the first match in the model file."""
        file = self.folder / "arm.toml"
        text, count = re.subn(pattern, new, file.read_text(encoding="utf-8"), count=1)
        if not count:
            raise ValueError(f"{file}: no {pattern}")
        file.write_text(text, encoding="utf-8")


@dataclass(frozen=True)
class Fault:
    """What is wrong, the verb, how it is planted, and a pattern of the words that name it."""

    what: str
    verb: str
    plant: Callable[[Lab], None]
    named: str


def scaled(columns: np.ndarray, at: list[int], factor: float) -> np.ndarray:
    """Some columns times a factor."""
    out = columns.copy()
    out[:, at] *= factor
    return out


def exchanged(columns: np.ndarray, i: int, j: int) -> np.ndarray:
    """Two columns in each other's place."""
    out = columns.copy()
    out[:, [i, j]] = columns[:, [j, i]]
    return out


def poses(function: Callable[[np.ndarray, int], np.ndarray]) -> Callable[[Lab], None]:
    """Fault of the table of poses, as a function of its columns and the number of joints."""
    return lambda lab: lab.change("poses.csv", lambda x: function(x, lab.joints))


def motion(function: Callable[[np.ndarray, int], np.ndarray]) -> Callable[[Lab], None]:
    """Fault of the recorded motion, as a function of its columns and the number of motors."""
    return lambda lab: lab.change("rigid.csv", lambda x: function(x, lab.joints))


def file_says(pattern: str, new: str) -> Callable[[Lab], None]:
    """Fault of the model file."""
    return lambda lab: lab.edit(pattern, new)


def moved_tracker(x: np.ndarray, n: int) -> np.ndarray:
    """Half of the poses with the tracker 3 mm away."""
    out = x.copy()
    out[len(x) // 2 :, n:] += np.array([0.003, -0.001, 0.002])
    return out


def stuck(columns: np.ndarray, at: int, begin: int) -> np.ndarray:
    """A column that keeps its value from a row on."""
    out = columns.copy()
    out[begin:, at] = columns[begin, at]
    return out


def other_robot(lab: Lab) -> None:
    """Poses of a robot whose links are 30 % longer."""
    for name in ("upper", "fore"):
        file = lab.folder / "arm.toml"
        text = file.read_text(encoding="utf-8")
        head, mark, tail = text.partition(f'name = "{name}"\norigin = {{ position = [')
        values, _, rest = tail.partition("]")
        new = ", ".join(str(0.7 * float(v)) for v in values.split(","))
        file.write_text(head + mark + new + "]" + rest, encoding="utf-8")


def lost_samples(x: np.ndarray, n: int) -> np.ndarray:
    """A twentieth of the rows is lost at random; the times are those of a full record."""
    kept = np.sort(np.random.default_rng(0).permutation(len(x))[len(x) // 20 :])
    out = x[kept]
    out[:, 0] = x[: len(out), 0]
    return out


def late(x: np.ndarray, n: int) -> np.ndarray:
    """Torques 200 ms later than angles."""
    out = x[200:].copy()
    out[:, 1 + n :] = x[:-200, 1 + n :]
    return out


def saturated(x: np.ndarray, n: int) -> np.ndarray:
    """Torque of the second motor within 60 % of its largest value."""
    out = x.copy()
    most = 0.6 * np.abs(x[:, 2 + n]).max()
    out[:, 2 + n] = np.clip(x[:, 2 + n], -most, most)
    return out


def remove_record(lab: Lab) -> None:
    """The file that the description names is not there."""
    (lab.folder / "rigid.csv").rename(lab.folder / "rigid_old.csv")


DEGREES = 180.0 / np.pi
FAULTS = (
    Fault("poses, no fault", "calibrate", poses(lambda x, n: x), "^$"),
    Fault("columns of q1 and q2 exchanged", "calibrate",
          poses(lambda x, n: exchanged(x, 0, 1)), "exchanged columns of q1 and q2"),
    Fault("sign of q2", "calibrate", poses(lambda x, n: scaled(x, [1], -1.0)), "sign of q2"),
    Fault("joints in degrees", "calibrate",
          poses(lambda x, n: scaled(x, list(range(n)), DEGREES)), "joints in degrees"),
    Fault("positions in mm", "calibrate",
          poses(lambda x, n: scaled(x, [n, n + 1, n + 2], 1e3)), "positions in mm"),
    Fault("left-handed frame of the tracker", "calibrate",
          poses(lambda x, n: scaled(x, [n + 1], -1.0)), "left-handed"),
    Fault("positions 1.6 % too small", "calibrate",
          poses(lambda x, n: scaled(x, [n, n + 1, n + 2], 0.984)),
          "scale of the measured positions"),
    Fault("link 20 mm longer than in the file", "calibrate",
          file_says(r'(name = "fore"\norigin = \{ position = \[)([\d.]+)', r"\g<1>0.83"),
          r"fore\.x"),
    Fault("robot on a wall, file on the floor", "calibrate",
          file_says(r"gravity = \[0.0, 0.0, -9.81\]", "gravity = [9.81, 0.0, 0.0]"), "gravity"),
    Fault("tracker moved by 3 mm from the middle on", "calibrate", poses(moved_tracker),
          "frame of the measurement that moved"),
    Fault("encoder of q2 stuck from the middle on", "calibrate",
          poses(lambda x, n: stuck(x, 1, len(x) // 2)), "q2 stuck"),
    Fault("payload of 12 kg in the file", "calibrate",
          file_says(r"(\[payload\]\nmass = )([\d.]+)", r"\g<1>12.0"), "payload"),
    Fault("payload's center in the wrong frame", "calibrate",
          file_says(r"(\[payload\]\n.*\ncom = \[)([^\]]*)", r"\g<1>0.0, 0.3, 0.2"), "payload"),
    Fault("poses of another robot", "calibrate", other_robot,
          r"another robot|scale of the measured positions|fore\.x"),
    Fault("motion, no fault", "rigid", motion(lambda x, n: x), "^$"),
    Fault("torques of m1 and m2 exchanged", "rigid",
          motion(lambda x, n: exchanged(x, 1 + n, 2 + n)), "torques of m1 and m2.*exchanged"),
    Fault("sign of the torque of m2", "rigid",
          motion(lambda x, n: scaled(x, [2 + n], -1.0)), "sign of the torques? of m2"),
    Fault("ratio of the gear of m2 10 % wrong", "rigid",
          file_says(r"(drives = \"q2\"\nratio = )([\d.]+)", r"\g<1>99.0"), "ratio.*q2"),
    Fault("torque of m2 on the arm side", "rigid",
          motion(lambda x, n: scaled(x, [2 + n], 110.0)), "torques? of (motor )?m2 .*arm side"),
    Fault("gravity upside down in the file", "rigid",
          file_says(r"gravity = \[0.0, 0.0, -9.81\]", "gravity = [0.0, 0.0, 9.81]"), "gravity"),
    Fault("torque of m2 20 % too large", "rigid",
          motion(lambda x, n: scaled(x, [2 + n], 1.2)), "torques? of m2"),
    Fault("torques late by 200 ms", "rigid", motion(late), "late|delay"),
    Fault("torque of m2 saturated", "rigid", motion(saturated), "saturat"),
    Fault("5 % of the samples lost", "rigid", motion(lost_samples), "samples"),
    Fault("clock 5 % slow", "rigid",
          motion(lambda x, n: scaled(x, [0], 1.05)), "clock"),
    Fault("encoder of m2 stuck from the middle on", "rigid",
          motion(lambda x, n: stuck(x, 2, len(x) // 2)), "angles of m2 are stuck"),
    Fault("angles in degrees", "rigid",
          motion(lambda x, n: scaled(x, list(range(1, 1 + n)), DEGREES)), "degrees"),
    Fault("payload of 12 kg in the file, motion", "rigid",
          file_says(r"(\[payload\]\nmass = )([\d.]+)", r"\g<1>12.0"), "payload.mass"),
    Fault("payload's center in the wrong frame, motion", "rigid",
          file_says(r"(\[payload\]\n.*\ncom = \[)([^\]]*)", r"\g<1>0.0, 0.3, 0.2"), "payload.com"),
    Fault("all torques 20 % too large", "rigid",
          motion(lambda x, n: scaled(x, list(range(1 + n, 1 + 2 * n)), 1.2)),
          "scale of all torques"),
    Fault("both signs of m2", "rigid",
          motion(lambda x, n: scaled(x, [2, 2 + n], -1.0)), "both signs of m2"),
    Fault("file of the record missing", "rigid", remove_record, "rigid.csv"),
)  # fmt: skip


def call(words: list[str]) -> tuple[int, str]:
    """Exit status and text of a verb of flexgen."""
    from flexgen.cli.main import main as flexgen

    text = StringIO()
    with redirect_stdout(text), redirect_stderr(text):
        status = int(flexgen(words))
    return status, text.getvalue()


def causes_in(text: str) -> list[str]:
    """Lines that name a cause."""
    return [line for line in text.splitlines() if CAUSE.search(line)]


def judge(fault: Fault, status: int, text: str) -> str:
    """Verdict on the text of a verb, see the head of this module."""
    causes = causes_in(text)
    if fault.named == "^$":
        if causes:
            return "misnamed"
        return "refused" if status else "fitted"
    said = causes or [line for line in text.splitlines() if line.startswith("flexgen:")]
    if any(re.search(fault.named, line) for line in said):
        return "named"
    if causes:
        return "misnamed"
    if status:
        return "refused"
    limits = [line for line in text.splitlines() if line.startswith("not visible in ")]
    return "stated" if any(re.search(fault.named, line) for line in limits) else "silent"


def run(fault: Fault, records: Path, place: Path) -> tuple[str, str]:
    """Verdict and text of one fault, planted in a copy of the records."""
    shutil.rmtree(place, ignore_errors=True)
    shutil.copytree(records, place)
    fault.plant(Lab(place))
    words = {
        "calibrate": ["calibrate", f"{place}/arm.toml", f"{place}/poses.csv"],
        "rigid": ["identify", f"{place}/arm.toml@joints", f"{place}/rigid.toml", "--rigid"],
        "commission": ["commission", f"{place}/arm.toml", str(place)],
    }[fault.verb]
    status, text = call([*words, "--out", str(place / "out.toml")])
    return judge(fault, status, text), text


def make_records(robot: str, folder: Path, seed: int = SEED) -> Path:
    """Folder with the records of a drawn robot."""
    records = folder / robot / "records"
    if not (records / "rigid.toml").is_file():
        records.mkdir(parents=True, exist_ok=True)
        plant = Plant(draw(robot, seed), seed)
        write_datasheet(stated(robot), records / "arm.toml")
        write_poses(plant, records, SHORT, seed)
        write_rigid(plant, records, SHORT, seed)
    return records


def main() -> None:
    """Verdicts of all faults as a table, and the texts in FOLDER/ROBOT/WHAT/text.txt."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--robot", choices=NAMES, default="three_axes")
    parser.add_argument("--only", default="")
    parser.add_argument("--seed", type=int, default=SEED)
    given = parser.parse_args()
    records = make_records(given.robot, given.folder, given.seed)
    counts: dict[str, int] = {}
    for fault in FAULTS:
        if given.only not in fault.what:
            continue
        began = time.perf_counter()
        place = given.folder / given.robot / re.sub(r"\W+", "_", fault.what)
        verdict, text = run(fault, records, place)
        (place / "text.txt").write_text(text, encoding="utf-8")
        counts[verdict] = counts.get(verdict, 0) + (fault.named != "^$")
        spent = time.perf_counter() - began
        print(f"| {fault.what} | {fault.verb} | {verdict} | {spent:.0f} s |", flush=True)
    print(counts)


if __name__ == "__main__":
    main()
