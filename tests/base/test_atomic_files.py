"""Files are complete or as before; temporary files of killed processes are removed, those in use
never.
"""

from __future__ import annotations

import errno
import os
import signal
import stat
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

import flexgen.cli.main
from flexgen.base.errors import ArgumentError
from flexgen.base.files import atomic_files
from flexgen.base.files.atomic_files import (
    FILE,
    FOLDER,
    atomic_file,
    follow_links,
    remove_leftovers,
    staging_folder,
    temporary_folder,
    unwritable,
    write_text,
)
from flexgen.codegen.build.source_folder import write_folder
from flexgen.studies.sweeps.cases import Grid
from flexgen.studies.sweeps.folder import Folder

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
        assert reader.read() == "one\n"  # an open file keeps its content
    assert path.read_text() == "two\n" and stat.S_IMODE(path.stat().st_mode) == 0o600
    assert (tmp_path / "link").is_symlink() and [p.name for p in path.parent.iterdir()] == [
        "a.txt"
    ]


STICKY = 0o1777


def stranger(path) -> None:
    """Give a link to another user."""
    if os.geteuid() != 0:
        pytest.skip("only root can give a file away")
    os.chown(path, 65534, -1, follow_symlinks=False)


@pytest.mark.parametrize("mode", [STICKY, 0o777])
@pytest.mark.parametrize("way", ["file", "folder", "chain"])
def test_a_link_of_another_user_in_a_folder_open_to_every_user_is_not_followed(
    tmp_path, mode, way
):
    mine = tmp_path / "mine"
    shared = tmp_path / "shared"
    mine.mkdir()
    shared.mkdir()
    shared.chmod(mode)
    victim = write_text(mine / "keys", "secret\n")
    link = shared / "link"
    link.symlink_to(mine if way == "folder" else victim)
    stranger(link)
    if way == "chain":
        (tmp_path / "own").symlink_to(link)
    path = {"file": link, "folder": link / "keys", "chain": tmp_path / "own"}[way]
    with pytest.raises(
        ArgumentError,
        match=f"'{link}' is a symbolic link of the user 65534 in a folder that every user",
    ):
        write_text(path, "changed\n")
    assert victim.read_text() == "secret\n" and [p.name for p in mine.iterdir()] == ["keys"]
    # the same link of the user is followed
    os.chown(link, os.geteuid(), -1, follow_symlinks=False)
    write_text(path, "changed\n")
    assert victim.read_text() == "changed\n" and link.is_symlink()


def test_the_rule_for_links_holds_for_users_other_than_root(tmp_path, monkeypatch):
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(STICKY)
    (shared / "link").symlink_to(tmp_path / "a.txt")
    monkeypatch.setattr(os, "geteuid", lambda: 4321)
    real = Path.lstat
    for owner, allowed in ((4321, True), (0, True), (4322, False)):
        monkeypatch.setattr(
            Path,
            "lstat",
            lambda self, owner=owner: os.stat_result((*real(self)[:4], owner, *real(self)[5:])),
        )
        if allowed:
            assert follow_links(shared / "link") == tmp_path / "a.txt"
        else:
            with pytest.raises(ArgumentError, match="symbolic link of the user 4322"):
                follow_links(shared / "link")


@pytest.mark.skipif(sys.platform != "linux", reason="other systems follow other numbers of links")
def test_as_many_links_are_followed_as_linux_follows(tmp_path):
    folder = Path(os.path.realpath(tmp_path))
    (folder / "0").touch()
    refused = []
    for k in range(1, 43):
        (folder / str(k)).symlink_to(str(k - 1))
        try:
            os.stat(folder / str(k))
        except OSError as error:
            assert error.errno == errno.ELOOP
            refused.append(k)
            with pytest.raises(ArgumentError, match="links lead in a circle"):
                follow_links(folder / str(k))
        else:
            assert follow_links(folder / str(k)) == folder / "0"
    assert refused == [41, 42]


def test_followed_is_the_real_path_and_ends_for_circles(tmp_path):
    (tmp_path / "a" / "b").mkdir(parents=True)
    (tmp_path / "up").symlink_to("a/b/..")
    (tmp_path / "abs").symlink_to(tmp_path / "up" / "b")
    for path in ("up/x", "abs/../../up/b/x", "missing/../y", "./abs", "abs/x/y/z"):
        assert str(follow_links(tmp_path / path)) == os.path.realpath(tmp_path / path)
    (tmp_path / "one").symlink_to("two")
    (tmp_path / "two").symlink_to("one")
    with pytest.raises(ArgumentError, match="links lead in a circle"):
        write_text(tmp_path / "one", "")


def test_the_mode_of_a_file_of_another_user_is_not_kept(tmp_path):
    path = write_text(tmp_path / "a.txt", "one\n")
    path.chmod(0o777)
    stranger(path)
    write_text(path, "two\n")
    assert (
        stat.S_IMODE(path.stat().st_mode) == 0o666 & ~umask()
        and path.stat().st_uid == os.geteuid()
    )


def test_folders_to_be_written_through_a_link_of_another_user_are_refused(tmp_path):
    shared = tmp_path / "shared"
    mine = tmp_path / "mine"
    shared.mkdir()
    mine.mkdir()
    shared.chmod(STICKY)
    (shared / "link").symlink_to(mine)
    stranger(shared / "link")
    grid = Grid(["elbow"])
    writers = (
        lambda out: flexgen.generate("elbow", out, build=False),
        lambda out: write_folder(out, "ros2", "elbow", {"a.txt": "a"}),
        lambda out: Folder(out, grid, "1", None, False, print),
        lambda out: (
            flexgen.cli.main.main(["models", "--log", str(out / "log")])
            and write_text(out / "log", "")
        ),
    )
    for write in writers:
        with pytest.raises(ArgumentError, match="is a symbolic link of the user 65534"):
            write(shared / "link")
    assert list(mine.iterdir()) == []


def umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


@pytest.mark.parametrize(
    "error", [OSError(errno.ENOSPC, "No space left on device"), KeyboardInterrupt()]
)
def test_a_failed_write_leaves_the_old_file(tmp_path, error):
    path = write_text(tmp_path / "a.txt", "one\n")
    expected = ArgumentError if isinstance(error, OSError) else KeyboardInterrupt
    with pytest.raises(expected) as caught, atomic_file(path) as stream:
        stream.write(b"tw")
        raise error
    if isinstance(error, OSError):
        assert "(No space left on device); free space on this disk" in str(caught.value) and str(
            path
        ) in str(caught)
    assert path.read_text() == "one\n" and [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_reasons_have_advice():
    told = {
        code: str(unwritable("x", OSError(code, "reason")))
        for code in (errno.EACCES, errno.EROFS, errno.EIO)
    }
    assert "choose a folder that you may write" in told[errno.EACCES]
    assert "choose another path" in told[errno.EIO] and all(
        "'x'" in text for text in told.values()
    )


def test_leftovers_are_removed_but_never_those_in_use(tmp_path):
    program = (
        "import sys, time, pathlib\n"
        "from flexgen.base.files.atomic_files import atomic_file, staging_folder\n"
        "with staging_folder(pathlib.Path(sys.argv[1])) as folder, atomic_file(sys.argv[1] + "
        "'/a.txt') as stream:\n"
        "    (folder / 'inside').write_text('x')\n"
        "    stream.write(b'half'), stream.flush()\n"
        "    print('ready', flush=True)\n"
        "    time.sleep(100)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program, str(tmp_path)], stdout=subprocess.PIPE
    ) as process:
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


def test_temporary_folders_of_killed_processes_are_removed(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    left = tmp_path / f"{FOLDER}killed"
    (left / "inside").mkdir(parents=True)
    make_old(left)
    (tmp_path / "other").mkdir()
    with pytest.raises(KeyboardInterrupt), temporary_folder() as folder:
        assert not left.exists() and folder.parent == tmp_path
        (folder / "inside").write_text("x")
        raise KeyboardInterrupt
    assert [path.name for path in tmp_path.iterdir()] == ["other"]


def test_a_folder_that_becomes_a_link_is_not_followed(tmp_path, monkeypatch):
    """Between the check of a path and the write another process puts a link into its place."""
    given = tmp_path / "given"
    mine = tmp_path / "mine"
    given.mkdir()
    mine.mkdir()
    check = atomic_files.follow_links

    def then_swapped(path):
        found = check(path)
        given.rename(tmp_path / "moved")
        given.symlink_to(mine)
        return found

    monkeypatch.setattr(atomic_files, "follow_links", then_swapped)
    with pytest.raises(ArgumentError, match="cannot be written"):
        write_text(given / "a.txt", "x")
    assert not [*mine.iterdir(), *(tmp_path / "moved").iterdir()]


def test_a_folder_that_becomes_a_link_while_it_is_written(tmp_path):
    """The file stays in the folder that was opened."""
    given = tmp_path / "given"
    mine = tmp_path / "mine"
    mine.mkdir()
    with atomic_file(given / "a.txt") as stream:
        stream.write(b"x")
        given.rename(tmp_path / "moved")
        given.symlink_to(mine)
    assert not [*mine.iterdir()]
    assert [path.name for path in (tmp_path / "moved").iterdir()] == ["a.txt"]
