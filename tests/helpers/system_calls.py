"""Observe and restrict the system calls of a command: which paths it writes, and that it opens no internet socket."""

import ctypes
import os
import platform
import re
import shutil
import struct
import subprocess
from collections.abc import Sequence
from functools import cache
from pathlib import Path

# --- no internet sockets ------------------------------------------------------------------------------------------

_SOCKET_CALLS = {"x86_64": 41, "aarch64": 198}  # the number of socket(2)
_SECCOMP_KILL, _SECCOMP_ALLOW = 0x80000000, 0x7FFF0000
_AF_INET, _AF_INET6 = 2, 10
_LOAD, _JUMP_IF_EQUAL, _RETURN = 0x20, 0x15, 0x06

KILLED_BY_FILTER = -31  # the return code of a process that SIGSYS ended


def can_forbid_internet() -> bool:
    """Whether the filter of `forbid_internet` is written for this machine."""
    return platform.machine() in _SOCKET_CALLS


def forbid_internet() -> None:
    """Let the kernel kill this process, and any that it starts, when it creates an internet socket.

    For `preexec_fn`. Unlike a patched `socket` module, this also holds for sockets that are opened by C++ code.
    Needs neither privileges nor other tools.
    """
    program = (
        (_LOAD, 0, 0, 0),  # the number of the system call
        (_JUMP_IF_EQUAL, 0, 4, _SOCKET_CALLS[platform.machine()]),
        (_LOAD, 0, 0, 16),  # its first argument, the address family
        (_JUMP_IF_EQUAL, 1, 0, _AF_INET),
        (_JUMP_IF_EQUAL, 0, 1, _AF_INET6),
        (_RETURN, 0, 0, _SECCOMP_KILL),
        (_RETURN, 0, 0, _SECCOMP_ALLOW),
    )
    instructions = b"".join(struct.pack("HBBI", *instruction) for instruction in program)
    buffer = ctypes.create_string_buffer(instructions)
    header = ctypes.create_string_buffer(struct.pack("HP", len(program), ctypes.addressof(buffer)))
    libc = ctypes.CDLL(None, use_errno=True)
    for arguments in ((38, 1, 0, 0, 0), (22, 2, header, 0, 0)):  # PR_SET_NO_NEW_PRIVS, PR_SET_SECCOMP with a filter
        if libc.prctl(*arguments) != 0:
            raise OSError(ctypes.get_errno(), "prctl")


# --- written paths ------------------------------------------------------------------------------------------------

_TRACE_OPTIONS = ("-f", "-y", "-qq", "--seccomp-bpf", "-s", "4096", "-e", "trace=%file", "-e", "status=successful")
_READS = ("stat", "access", "readlink", "execve", "getcwd", "chdir", "xattr", "open_tree", "inotify", "statfs")
_OPENED_FOR_WRITING = re.compile(r"O_WRONLY|O_RDWR|O_CREAT|O_TRUNC")
_PATH = re.compile(r'(?:<(?P<folder>[^<>"]*)>, )?"(?P<path>(?:[^"\\]|\\.)*)"')


@cache
def can_trace() -> bool:
    """Whether strace is installed, and allowed on this machine."""
    if shutil.which("strace") is None:
        return False
    return subprocess.run(["strace", *_TRACE_OPTIONS, "true"], capture_output=True, check=False).returncode == 0


def trace_command(command: Sequence[str], log: Path) -> list[str]:
    """The command under strace, which writes the calls that name a file to `log`."""
    return ["strace", *_TRACE_OPTIONS, "-o", str(log), *command]


def trace_internet(command: Sequence[str], log: Path) -> list[str]:
    """The command under strace, which writes the addresses that it connects or sends to. Local sockets count too."""
    return ["strace", "-f", "-qq", "-e", "trace=connect,sendto,sendmsg", "-o", str(log), *command]


def written_paths(log: Path, cwd: Path) -> set[Path]:
    """The absolute paths that a traced command created, opened for writing, renamed, changed or removed."""
    written: set[Path] = set()
    for line in log.read_text(errors="replace").splitlines():
        call = re.match(r"\d+ +(\w+)\(", line)
        if call is None or any(word in call[1] for word in _READS):
            continue
        if call[1].startswith("open") and not _OPENED_FOR_WRITING.search(line):
            continue
        if "O_TMPFILE" in line:
            continue  # a file without a name
        if "/proc/self/fd/" in line:
            continue  # a pipe or file of this process, which counted when it was opened
        arguments = line[: line.rindex(" = ")]
        for match in _PATH.finditer(arguments):
            folder = match["folder"] if match["folder"] else cwd
            written.add(Path(os.path.normpath(Path(folder) / match["path"])))
    return written
