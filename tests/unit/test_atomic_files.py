"""Files are complete or as before; temporary files of killed processes are removed, those in use never."""

from __future__ import annotations

import errno
import os
import signal
import stat
import subprocess
import sys
import time

import pytest

from flexgen import atomic_files
from flexgen.atomic_files import FILE, FOLDER, atomic_file, remove_leftovers, staging_folder, unwritable, write_text
from flexgen.errors import ArgumentError

pytestmark = pytest.mark.skipif(os.name != "posix", reason="locks and modes of POSIX")


def make_old(path) -> None:
    then = time.time() - atomic_files.GRACE - 10
    os.utime(path, (then, then))


def test_the_old_file_is_replaced_and_keeps_its_mode(tmp_path):
    path = tmp_path / "new" / "a.txt"
    write_text(path, "one\n")
    assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~umask()
    path.chmod(0o600)
    (tmp_path / "link").symlink_to(path)
    with open(path) as reader:
        write_text(tmp_path / "link", "two\n")
        assert reader.read() == "one\n"  # whoever has it open keeps what was there
    assert path.read_text() == "two\n" and stat.S_IMODE(path.stat().st_mode) == 0o600
    assert (tmp_path / "link").is_symlink() and [p.name for p in path.parent.iterdir()] == ["a.txt"]


def umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "No space left on device"), KeyboardInterrupt()])
def test_what_fails_leaves_the_old_file(tmp_path, error):
    path = write_text(tmp_path / "a.txt", "one\n")
    expected = ArgumentError if isinstance(error, OSError) else KeyboardInterrupt
    with pytest.raises(expected) as caught, atomic_file(path) as stream:
        stream.write(b"tw")
        raise error
    if isinstance(error, OSError):
        assert "(No space left on device); free space on this disk" in str(caught.value) and str(path) in str(caught)
    assert path.read_text() == "one\n" and [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_reasons_have_advice():
    told = {code: str(unwritable("x", OSError(code, "reason"))) for code in (errno.EACCES, errno.EROFS, errno.EIO)}
    assert "choose a folder that you may write" in told[errno.EACCES]
    assert "choose another path" in told[errno.EIO] and all("'x'" in text for text in told.values())


def test_leftovers_are_removed_but_never_those_in_use(tmp_path):
    program = (
        "import sys, time, pathlib\n"
        "from flexgen.atomic_files import atomic_file, staging_folder\n"
        "with staging_folder(pathlib.Path(sys.argv[1])) as folder, atomic_file(sys.argv[1] + '/a.txt') as stream:\n"
        "    (folder / 'inside').write_text('x')\n"
        "    stream.write(b'half'), stream.flush()\n"
        "    print('ready', flush=True)\n"
        "    time.sleep(100)\n"
    )
    with subprocess.Popen([sys.executable, "-c", program, str(tmp_path)], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None and process.stdout.readline() == b"ready\n"
        left = sorted(tmp_path.iterdir())
        assert [path.name[:9] for path in left] == [FILE, FOLDER]
        for path in left:
            make_old(path)
        remove_leftovers(tmp_path)
        assert sorted(tmp_path.iterdir()) == left
        process.send_signal(signal.SIGKILL)
        process.wait()
    os.utime(left[0])
    remove_leftovers(tmp_path)
    assert list(tmp_path.iterdir()) == left[:1]  # what is young stays
    make_old(left[0])
    write_text(tmp_path / "b.txt", "")  # each writer removes them
    assert [path.name for path in tmp_path.iterdir()] == ["b.txt"]


def test_other_files_stay(tmp_path):
    (tmp_path / f"{FOLDER}link").symlink_to(tmp_path)
    for name in ("staging-x", "flexgen-x", ".other"):
        (tmp_path / name).write_text("")
        make_old(tmp_path / name)
    before = sorted(tmp_path.iterdir())
    remove_leftovers(tmp_path)
    remove_leftovers(tmp_path / "nowhere")
    assert sorted(tmp_path.iterdir()) == before


def test_where_files_cannot_be_locked_only_old_ones_are_removed(tmp_path, monkeypatch):
    monkeypatch.setattr(atomic_files, "fcntl", None)
    with staging_folder(tmp_path) as folder:
        make_old(folder)
        remove_leftovers(tmp_path)
        assert folder.is_dir()
        os.utime(folder, (1e9, 1e9))
        remove_leftovers(tmp_path)
        assert not folder.exists()


def test_devices_are_written_directly():
    write_text("/dev/null", "x")
    assert stat.S_ISCHR(os.stat("/dev/null").st_mode)
