"""Folders that only the user and root can change, including all parent folders.

navsim executes cached machine code. Whoever can write a parent folder can replace the cache. So every folder of the
path is checked, as OpenSSH does for keys (`StrictModes`), and opened relative to its checked parent. A check of the
path alone would leave time to exchange a folder between check and use.

- A folder belongs to the user or to root, and neither group nor others may write it.
- Exception: a group that is the user's alone ("user private group", as Debian and Fedora make them) may write.
- Exception: in a sticky folder, such as /tmp, everybody may write, but nobody can exchange what belongs to another.
- A symbolic link belongs to the user or to root, and the path that it names is checked like any other.
"""

from __future__ import annotations

import errno
import grp
import os
import pwd
import stat
import uuid
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

_FOLDER = getattr(os, "O_PATH", os.O_RDONLY) | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
_FILE = os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
"""A pipe does not wait for its writer, and is then found to be no file."""
_MOST_LINKS = 40
"""Symbolic links in one path, as in Linux."""
_READ_BY_ALL = 0o644
_USERS_ALONE = 0o700


class ChangeableByOthersError(OSError):
    """Another user can change a folder or file. The message names both."""

    def __init__(self, path: Path, why: str) -> None:
        super().__init__(errno.EPERM, why, str(path))
        self.why = why
        self.path = path

    def __str__(self) -> str:
        return f"{self.path} {self.why}"


@dataclass(frozen=True)
class ProtectedFolder:
    """An open folder that only the user and root can change.

    descriptor: of the open folder; files are found by it and not by the path. path: for messages, links resolved.
    """

    descriptor: int
    path: Path

    def __str__(self) -> str:
        return str(self.path)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, _: type[BaseException] | None, __: BaseException | None, ___: TracebackType | None) -> None:
        os.close(self.descriptor)

    def is_writable(self) -> bool:
        return os.access(".", os.W_OK, dir_fd=self.descriptor)

    def read(self, name: str) -> bytes:
        """Content of a file. Raises OSError, ChangeableByOthersError."""
        with os.fdopen(os.open(name, os.O_RDONLY | _FILE, dir_fd=self.descriptor), "rb") as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise OSError(errno.EINVAL, "is not a file", str(self.path / name))
            _check(status, file.fileno(), self.path / name, sticky_suffices=False)
            return file.read()

    def write(self, name: str, parts: Iterable[bytes | memoryview]) -> None:
        """Write a file atomically. Raises OSError."""
        temporary = f"{name}.tmp.{uuid.uuid4().hex[:16]}"
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | _FILE
        try:
            with os.fdopen(os.open(temporary, flags, _READ_BY_ALL, dir_fd=self.descriptor), "wb") as file:
                file.writelines(parts)
            os.replace(temporary, name, src_dir_fd=self.descriptor, dst_dir_fd=self.descriptor)
        finally:
            self.remove(temporary)

    def remove(self, name: str) -> None:
        """Remove a file if it can be removed."""
        with suppress(OSError):
            os.unlink(name, dir_fd=self.descriptor)

    def touch(self, name: str) -> None:
        """Set the time of a file to now. Raises OSError."""
        os.utime(name, dir_fd=self.descriptor, follow_symlinks=False)

    def exists(self, name: str) -> bool:
        with suppress(FileNotFoundError):
            os.stat(name, dir_fd=self.descriptor, follow_symlinks=False)
            return True
        return False

    def time_of(self, name: str) -> float:
        """Time of the last change of a file, in seconds since 1970. Raises OSError."""
        return os.stat(name, dir_fd=self.descriptor, follow_symlinks=False).st_mtime

    def names(self) -> list[str]:
        """Names of files and folders in it. Raises OSError."""
        with _open_checked(".", self.descriptor, os.O_RDONLY | os.O_DIRECTORY) as readable:
            return os.listdir(readable)


def open_protected_folder(path: Path) -> ProtectedFolder:
    """Open the folder of an absolute path, and create missing folders for the user alone.

    In a sticky folder only the folders in it are protected, see `open_below`.

    Raises
    ------
    ChangeableByOthersError
        Another user can change a folder on the path.
    OSError
        A folder cannot be created or opened.
    """
    walked = Path("/")
    left = list(reversed(path.parts[1:]))
    links = 0
    folder = os.open("/", _FOLDER)
    try:
        _check(os.fstat(folder), folder, walked, sticky_suffices=True)
        while left:
            name = left.pop()
            target = _link(name, folder, walked)
            if target is not None:
                links += 1
                if links > _MOST_LINKS:
                    raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path))
                if target.is_absolute():
                    folder, walked = _exchange(folder, os.open("/", _FOLDER)), Path("/")
                left.extend(reversed([part for part in target.parts if part != "/"]))
                continue
            folder = _exchange(folder, _open_or_make(name, folder))
            walked = walked.parent if name == ".." else walked / name
            _check(os.fstat(folder), folder, walked, sticky_suffices=True)
    except BaseException:
        os.close(folder)
        raise
    return ProtectedFolder(folder, walked)


def open_below(folder: ProtectedFolder, name: str) -> ProtectedFolder:
    """Open a folder in an open one, and create it if it is missing. Raises OSError, ChangeableByOthersError."""
    descriptor = _open_or_make(name, folder.descriptor)
    try:
        _check(os.fstat(descriptor), descriptor, folder.path / name, sticky_suffices=False)
    except BaseException:
        os.close(descriptor)
        raise
    return ProtectedFolder(descriptor, folder.path / name)


def _exchange(old: int, new: int) -> int:
    os.close(old)
    return new


@contextmanager
def _open_checked(name: str, folder: int, flags: int) -> Iterator[int]:
    descriptor = os.open(name, flags | os.O_CLOEXEC, dir_fd=folder)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def _open_or_make(name: str, folder: int) -> int:
    with suppress(FileNotFoundError):
        return os.open(name, _FOLDER, dir_fd=folder)
    with suppress(FileExistsError):  # another process was quicker
        os.mkdir(name, _USERS_ALONE, dir_fd=folder)
    return os.open(name, _FOLDER, dir_fd=folder)


def _link(name: str, folder: int, walked: Path) -> Path | None:
    """Target of a symbolic link; None where the name is none. Its owner is asked first: the link of another could be
    exchanged between the two."""
    try:
        status = os.stat(name, dir_fd=folder, follow_symlinks=False)
    except FileNotFoundError:
        return None
    if not stat.S_ISLNK(status.st_mode):
        return None
    if status.st_uid not in (0, os.geteuid()):
        raise ChangeableByOthersError(walked / name, f"is a link of {_name_user(status.st_uid)}")
    return Path(os.readlink(name, dir_fd=folder))


def _check(status: os.stat_result, descriptor: int, path: Path, sticky_suffices: bool) -> None:
    """Raise ChangeableByOthersError where another than the user and root can change a folder or file."""
    if status.st_uid not in (0, os.geteuid()):
        raise ChangeableByOthersError(path, f"belongs to {_name_user(status.st_uid)}")
    if sticky_suffices and status.st_mode & stat.S_ISVTX:
        return
    if status.st_mode & stat.S_IWOTH:
        raise ChangeableByOthersError(path, f"can be written by everybody (mode {stat.S_IMODE(status.st_mode):03o})")
    if status.st_mode & stat.S_IWGRP and not (_is_users_alone(status.st_gid) and not _has_access_list(descriptor)):
        raise ChangeableByOthersError(path, f"can be written by its group (mode {stat.S_IMODE(status.st_mode):03o})")


def _name_user(number: int) -> str:
    try:
        return pwd.getpwuid(number).pw_name
    except KeyError:
        return f"user {number}"


def _is_users_alone(number: int) -> bool:
    """Whether a group is the private one of the user: named as the user, primary group of no one else, without other
    members. The name decides too, since a directory service need not list all its users."""
    try:
        user, group = pwd.getpwuid(os.geteuid()), grp.getgrgid(number)
    except KeyError:
        return False
    return (
        (user.pw_gid, user.pw_name) == (number, group.gr_name)
        and set(group.gr_mem) <= {user.pw_name}
        and all(each.pw_uid == user.pw_uid for each in pwd.getpwall() if each.pw_gid == number)
    )


def _has_access_list(descriptor: int) -> bool:
    """Whether the group's bits are those of a POSIX access control list, which may name other users (Linux)."""
    try:
        return "system.posix_acl_access" in os.listxattr(f"/proc/self/fd/{descriptor}")
    except (AttributeError, OSError):  # another system, or a file system without lists
        return False
