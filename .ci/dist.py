"""Build sdist and wheel with the same bytes for the same sources: python .ci/dist.py [FOLDER],
default dist.

Times in the archives are SOURCE_DATE_EPOCH, by default the time of the last commit, so that
neither clock nor user nor the order of a directory changes a byte.
"""

from __future__ import annotations

import gzip
import io
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

from setuptools import build_meta

ROOT = Path(__file__).resolve().parents[1]
OLDEST = 315532800  # 1980-01-01: zip files cannot have an earlier time


def epoch() -> int:
    """Time of all files in the archives [s since 1970]."""
    given = os.environ.get("SOURCE_DATE_EPOCH")
    if given is None:
        command = ["git", "log", "-1", "--format=%ct"]
        found = subprocess.run(
            command, cwd=ROOT, capture_output=True, text=True, check=False
        ).stdout.strip()
        given = found or str(OLDEST)
    return max(int(given), OLDEST)


def normalized(archive: Path, time: int) -> None:
    """Write a .tar.gz again: files sorted, with one time, owner and mode."""
    with tarfile.open(archive) as old:
        files = [m for m in old.getmembers() if m.isfile()]
        members = [(m, old.extractfile(m).read()) for m in files]  # type: ignore[union-attr]
    raw = io.BytesIO()
    with tarfile.open(fileobj=raw, mode="w", format=tarfile.PAX_FORMAT) as new:
        for member, data in sorted(members, key=lambda pair: pair[0].name):
            info = tarfile.TarInfo(member.name)
            info.size = len(data)
            info.mtime = time
            info.mode = 0o644
            new.addfile(info, io.BytesIO(data))
    with archive.open("wb") as stream, gzip.GzipFile("", "wb", 9, stream, mtime=time) as packed:
        packed.write(raw.getvalue())


def build(folder: Path) -> list[Path]:
    """Write the sdist, and the wheel from the sdist, to a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    time = epoch()
    os.environ["SOURCE_DATE_EPOCH"] = str(time)
    os.umask(0o022)  # the wheel has the modes of the files
    os.chdir(ROOT)
    information = ROOT / "flexgen_robotics.egg-info"
    there = information.exists()
    with tempfile.TemporaryDirectory() as scratch:
        sdist = Path(scratch) / build_meta.build_sdist(scratch)
        normalized(sdist, time)
        with tarfile.open(sdist) as archive:
            archive.extractall(Path(scratch) / "source", filter="data")
        (source,) = (Path(scratch) / "source").iterdir()
        os.chdir(source)
        wheel = Path(scratch) / build_meta.build_wheel(scratch)
        os.chdir(ROOT)
        made = [folder / sdist.name, folder / wheel.name]
        for old, new in zip((sdist, wheel), made, strict=True):
            new.write_bytes(old.read_bytes())
    if not there:  # setuptools leaves it
        shutil.rmtree(information, ignore_errors=True)
    return made


if __name__ == "__main__":
    for path in build(Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "dist").resolve()):
        print(f"wrote {path}")
