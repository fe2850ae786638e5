"""The internet sockets of processes, read from /proc."""

import ipaddress
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

LISTEN, TIME_WAIT = "0A", "06"


class Socket(NamedTuple):
    """address: that it listens on, or that it is connected to. program: the command line of its process."""

    address: str
    program: str


def processes_with(variable: str, value: str) -> list[int]:
    """The processes that were started with a variable of this value."""
    entry = f"{variable}={value}".encode()
    return [pid for pid in _pids() if entry in _read(Path(f"/proc/{pid}/environ")).split(b"\0")]


def sockets_beyond_loopback(pids: list[int]) -> set[Socket]:
    """The sockets of these processes that other machines can reach, or that reach other machines."""
    owners = {inode: pid for pid in pids for inode in _socket_inodes(pid)}
    found = set()
    for line in (*_rows("/proc/net/tcp"), *_rows("/proc/net/tcp6")):
        local, remote, state, inode = line[1], line[2], line[3], line[9]
        address = _parse(local if state == LISTEN else remote)
        if inode in owners and not address.is_loopback:
            found.add(Socket(str(address), _read(Path(f"/proc/{owners[inode]}/cmdline")).decode().replace("\0", " ")))
    return found


def _pids() -> Iterator[int]:
    return (int(path.name) for path in Path("/proc").iterdir() if path.name.isdecimal())


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError:  # the process has ended, or is of another user
        return b""


def _socket_inodes(pid: int) -> Iterator[str]:
    with suppress(OSError):  # the process has ended, or is of another user
        for path in Path(f"/proc/{pid}/fd").iterdir():
            with suppress(OSError):  # the file was closed
                target = str(path.readlink())
                if target.startswith("socket:["):
                    yield target[8:-1]


def _rows(path: str) -> Iterator[list[str]]:
    return (line.split() for line in _read(Path(path)).decode().splitlines()[1:])


def _parse(text: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    """Parse an address such as "0100007F:1F90": words of 32 bits, each with its bytes reversed."""
    words = bytes.fromhex(text.partition(":")[0])
    address = ipaddress.ip_address(b"".join(words[i : i + 4][::-1] for i in range(0, len(words), 4)))
    return getattr(address, "ipv4_mapped", None) or address
