"""Bytes of a file from elsewhere: read once, and unpacked where gzip packed them, to a limit and no further."""

import gzip
import zlib
from io import BytesIO
from pathlib import Path
from typing import IO

from survey_sim.errors import InputError

GZIP_MAGIC = b"\x1f\x8b"
_BLOCK = 1 << 20
_SMALLER = "split it, or leave out what is not read"


def read_bytes(path: Path, max_bytes: int) -> bytes:
    """Content of a file as it is.

    Raises
    ------
    InputError
        It is not there, cannot be read, or holds more than `max_bytes`.
    """
    try:
        with path.open("rb") as file:
            content = _bounded(file, max_bytes)
    except FileNotFoundError:
        raise InputError("no such file", file=path, remedy="check the path") from None
    except OSError as failure:
        raise InputError(f"cannot be read: {failure.strerror}", file=path, remedy="check the path and its rights") from None
    if content is None:
        raise InputError(f"holds more than {max_bytes >> 20} MiB", file=path, remedy=_SMALLER)
    return content


def gunzip(content: bytes, path: Path, max_bytes: int) -> bytes:
    """What gzip packed, all of its members.

    Raises
    ------
    InputError
        It is damaged, breaks off, or unpacks to more than `max_bytes`.
    """
    try:
        with gzip.open(BytesIO(content)) as packed:
            unpacked = _bounded(packed, max_bytes)
    except EOFError:
        raise InputError("is a gzip file that breaks off", file=path, remedy="copy it again") from None
    except (OSError, zlib.error) as failure:
        raise InputError(f"is not a whole gzip file: {failure}", file=path, remedy="copy it again") from None
    if unpacked is None:
        raise InputError(f"unpacks to more than {max_bytes >> 20} MiB", file=path, remedy=_SMALLER)
    return unpacked


def _bounded(file: IO[bytes] | gzip.GzipFile, max_bytes: int) -> bytes | None:
    """All that a file has; None if that is more than the limit."""
    blocks, size = [], 0
    while block := file.read(_BLOCK):
        size += len(block)
        if size > max_bytes:
            return None
        blocks.append(block)
    return b"".join(blocks)
