"""Folders that only the user and root can change: every folder of the path decides, as OpenSSH's StrictModes has it."""

from __future__ import annotations

import grp
import os
import pwd
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from navsim.compiler import protected_folder
from navsim.compiler.protected_folder import ChangeableByOthersError, open_below, open_protected_folder

ANOTHER = 12345
as_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a folder away")


def refusal(path: Path) -> str:
    """The message about a path, without the path of the test."""
    with pytest.raises(ChangeableByOthersError) as caught:
        open_protected_folder(path)
    return str(caught.value)


def test_missing_folders_are_made_for_the_user_alone(tmp_path: Path) -> None:
    before = os.umask(0o002)
    try:
        with open_protected_folder(tmp_path / "a" / "b") as folder:
            folder.write("file", (b"of two ", memoryview(b"parts")))
            assert folder.read("file") == b"of two parts"
            assert folder.names() == ["file"]
    finally:
        os.umask(before)
    modes = [(tmp_path / name).stat().st_mode & 0o777 for name in ("a", "a/b", "a/b/file")]
    assert modes == [0o700, 0o700, 0o644]


@pytest.mark.parametrize("which", ["above", "above/own"])
@pytest.mark.parametrize("mode", [0o777, 0o757, 0o775, 0o2770])
def test_no_folder_of_the_path_can_be_written_by_others(which: str, mode: int, tmp_path: Path) -> None:
    (tmp_path / "above" / "own" / "deep").mkdir(parents=True, mode=0o700)
    (tmp_path / which).chmod(mode)
    if os.geteuid() == 0:
        os.chown(tmp_path / which, 0, ANOTHER)  # the group root:root is root's alone
    by = "everybody" if mode & 0o002 else "its group"
    assert refusal(tmp_path / "above" / "own" / "deep") == (
        f"{tmp_path / which} can be written by {by} (mode {mode:03o})"
    )


@as_root
@pytest.mark.parametrize("which", ["above", "above/own", "above/own/deep"])
def test_no_folder_of_the_path_belongs_to_another(which: str, tmp_path: Path) -> None:
    (tmp_path / "above" / "own" / "deep").mkdir(parents=True, mode=0o700)
    os.chown(tmp_path / which, ANOTHER, 0)
    assert refusal(tmp_path / "above" / "own" / "deep") == f"{tmp_path / which} belongs to user {ANOTHER}"


@as_root
def test_in_a_sticky_folder_what_belongs_to_another_is_refused(tmp_path: Path) -> None:
    """Others may put folders and links of any name there, but not exchange those of the user."""
    sticky = tmp_path / "tmp"
    sticky.mkdir()
    sticky.chmod(0o1777)
    open_protected_folder(sticky / "own" / "deep")
    assert (sticky / "own").stat().st_mode & 0o777 == 0o700
    (sticky / "planted").mkdir()
    (sticky / "link").symlink_to(sticky / "own")
    for name in ("planted", "link"):
        os.chown(sticky / name, ANOTHER, ANOTHER, follow_symlinks=False)
    assert refusal(sticky / "planted") == f"{sticky}/planted belongs to user {ANOTHER}"
    assert refusal(sticky / "link" / "deep") == f"{sticky}/link is a link of user {ANOTHER}"
    with open_protected_folder(sticky) as folder, pytest.raises(ChangeableByOthersError):
        open_below(folder, "planted")
    with open_protected_folder(tmp_path) as folder, pytest.raises(ChangeableByOthersError):
        open_below(folder, "tmp")  # files in a sticky folder are anybody's


def test_links_are_followed_and_what_they_name_is_checked(tmp_path: Path) -> None:
    (tmp_path / "own" / "deep").mkdir(parents=True)
    (tmp_path / "absolute").symlink_to(tmp_path / "own")
    (tmp_path / "own" / "relative").symlink_to("../own/deep")
    assert open_protected_folder(tmp_path / "absolute" / "relative").path == tmp_path / "own" / "deep"
    assert open_protected_folder(tmp_path / "absolute" / "relative" / ".." / "new").path == tmp_path / "own" / "new"
    (tmp_path / "own").chmod(0o777)
    assert refusal(tmp_path / "absolute").startswith(f"{tmp_path}/own can be written by everybody")
    (tmp_path / "round").symlink_to("round")
    with pytest.raises(OSError, match="Too many levels of symbolic links"):
        open_protected_folder(tmp_path / "round")


@as_root
def test_a_folder_that_is_exchanged_after_its_check_is_not_used(tmp_path: Path) -> None:
    """Files are found by the open folder."""
    folder = open_protected_folder(tmp_path / "own")
    folder.write("file", (b"own",))
    (tmp_path / "own").rename(tmp_path / "moved")
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "file").write_bytes(b"another's")
    assert folder.read("file") == b"own"
    folder.write("file", (b"new",))
    assert (tmp_path / "moved" / "file").read_bytes() == b"new"


def give_away(path: Path) -> None:
    os.chown(path, ANOTHER, ANOTHER)


def exchange_for_link(path: Path) -> None:
    path.rename(path.with_name("other"))
    path.symlink_to("other")


def exchange_for_pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


@as_root
@pytest.mark.parametrize("change", [give_away, exchange_for_link, exchange_for_pipe])
def test_a_file_that_was_planted_is_not_read(change: Callable[[Path], None], tmp_path: Path) -> None:
    """It may be there from a time when others could write the folder."""
    folder = open_protected_folder(tmp_path)
    folder.write("file", (b"code",))
    change(tmp_path / "file")
    with pytest.raises(OSError):  # noqa: PT011 (what it says differs from system to system)
        folder.read("file")


def test_the_users_private_group_may_write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Homes of Debian and Fedora may be 0770 or 0775 with a group that has nobody else; one of several people may not,
    whoever of them the directory of users lists."""
    own = tmp_path / "own"
    own.mkdir()
    own.chmod(0o775)
    group, user = own.stat().st_gid, pwd.getpwuid(os.geteuid())
    ann = SimpleNamespace(pw_uid=user.pw_uid, pw_gid=group, pw_name="ann")
    bob = SimpleNamespace(pw_uid=ANOTHER, pw_gid=group, pw_name="bob")
    monkeypatch.setattr(pwd, "getpwuid", lambda _: ann)

    def opened(name: str, members: list[str], users: list[SimpleNamespace]) -> bool:
        monkeypatch.setattr(grp, "getgrgid", lambda _: SimpleNamespace(gr_name=name, gr_mem=members))
        monkeypatch.setattr(pwd, "getpwall", lambda: users)
        try:
            open_protected_folder(own)
        except ChangeableByOthersError:
            return False
        return True

    assert opened("ann", [], [ann])
    assert opened("ann", ["ann"], [ann])
    assert not opened("ann", ["bob"], [ann])
    assert not opened("ann", [], [ann, bob])
    assert not opened("users", [], [ann])
    monkeypatch.setattr(protected_folder, "_has_access_list", lambda _: True)
    assert not opened("ann", [], [ann])
