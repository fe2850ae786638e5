"""The lock of an output folder: only one process at a time writes there.

On a local file system the folder itself is locked, so no file is needed, and a killed process leaves nothing behind.
NFS only locks files that are open for writing, which a folder cannot be. There, a file inside the folder is locked. It
is removed at the end. A killed process may leave it behind, unlocked; the next process uses and removes it.
"""

import errno
import fcntl
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from ..runtime.errors import OutputError
from .notify import Notify, ignore

LOCK_NAME = ".duospacenet.lock"
_NO_LOCKS = {errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOTSUP, errno.ENOSYS, errno.EINVAL}
_HELD = {errno.EWOULDBLOCK, errno.EAGAIN, errno.EACCES}  # EACCES: some SMB servers


@contextmanager
def lock_folder(out: Path, notify: Notify = ignore) -> Iterator[None]:
    """Lock the folder `out` until the block ends.

    notify: gets a warning if the file system has no locks. The block runs without a lock then.
    Raises OutputError if another process holds the lock, or if the folder cannot be opened.
    """
    with ExitStack() as stack:
        try:
            if not _lock_itself(out, stack) and not _lock_file(out / LOCK_NAME, stack):
                notify(f"warning: {out}: this file system has no locks. Do not start a second run there.")
        except OSError as error:
            if error.errno in _HELD and error.filename is None:
                raise OutputError(
                    f"{out}: another run is writing there. Wait for it, or choose another --out."
                ) from None
            raise OutputError(f"{out}: cannot be locked ({error.strerror}). Choose another --out.") from error
        yield


def _lock_itself(folder: Path, stack: ExitStack) -> bool:
    """Lock the descriptor of a folder. Returns false if the file system cannot. Raises OSError, also if it is held."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    stack.callback(os.close, descriptor)
    return _flock(descriptor, _NO_LOCKS | {errno.EBADF})  # EBADF: NFS


def _lock_file(path: Path, stack: ExitStack) -> bool:
    """Lock a file, which is removed when the stack closes. Returns and raises as `_lock_itself`."""
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        stack.callback(os.close, descriptor)
        locked = _flock(descriptor, _NO_LOCKS)
        if _is_at(path, descriptor):
            stack.callback(_remove, path)  # before the descriptor is closed, which ends the lock
            return locked
        # The process that held the lock has removed the file since it was opened. Lock the new file.


def _remove(path: Path) -> None:
    with suppress(OSError):  # a lock file that stays is harmless
        path.unlink()


def _flock(descriptor: int, unsupported: set[int]) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno not in unsupported:
            raise
        return False
    return True


def _is_at(path: Path, descriptor: int) -> bool:
    try:
        return os.path.samestat(path.stat(), os.fstat(descriptor))
    except FileNotFoundError:
        return False
