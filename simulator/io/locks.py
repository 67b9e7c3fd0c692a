"""Advisory locks on open files, which the system forgets when a process dies."""

from __future__ import annotations

import errno
from typing import IO

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

_NO_LOCKS = {errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOLCK}  # what file systems without locks answer


def take_lock(file: int | IO[bytes], *, shared: bool = False, wait: bool = False) -> bool | None:
    """Take the lock of an open file, or change the one that is held.

    Args:
        file: a file or its descriptor; closing it gives the lock back.
        shared: several may hold it so; by default one alone.
        wait: wait for whoever holds it otherwise.

    Returns:
        Whether it was taken; None where the file system knows no locks.

    Raises:
        OSError: the file system fails otherwise: nothing is known of the lock.
    """
    if fcntl is None:
        return None
    mode = (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | (0 if wait else fcntl.LOCK_NB)
    try:
        fcntl.flock(file, mode)
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno in _NO_LOCKS:
            return None
        raise
    return True
