"""The byte mutator: damages that transfers, editors and fuzzers make to any file."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Sequence
from random import Random

CHANGES = (1, 1, 1, 2, 3, 6)  # at a time: one is the most likely to get past a parser
MOST_BYTES, MOST_TEXT = 1 << 20, 1 << 14
INTERESTING = (
    0, 1, -1, 2, 7, 8, 16, 32, 64, 100, 127, 128, 255, 256, 1000, 1024, 4096, 32767, 32768, 65535, 65536, 2**31 - 1,
    2**31, 2**32 - 1, 2**63 - 1, 2**63, 2**64 - 1,
)  # fmt: skip
DIGITS = (b"", b"0", b"1", b"9", b"-1", b"00", b"999999", b"1e9", b"0.5", b"e", b"_", b"9" * 30)
_PNG = b"\x89PNG\r\n\x1a\n"

Change = Callable[[bytearray, Random, Sequence[bytes]], None]


def mutate(data: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    """Damage a file; parts of ``others``, files of the same kind, are spliced in."""
    result, text = bytearray(data), _is_text(data)
    for _ in range(rng.choice(CHANGES)):
        if not result:
            break
        rng.choice(_OF_TEXTS if text and rng.random() < 0.75 else _CHANGES)(result, rng, others)
    damaged = bytes(result[:MOST_BYTES])
    return with_checksums(damaged) if damaged.startswith(_PNG) and rng.random() < 0.5 else damaged


def _byte(data: bytearray, rng: Random, _: Sequence[bytes]) -> None:
    at = rng.randrange(len(data))
    data[at] = rng.choice((data[at] ^ 1 << rng.randrange(8), rng.randrange(256)))


def _cut(data: bytearray, rng: Random, _: Sequence[bytes]) -> None:
    start, end = _span(data, rng)
    del data[start : rng.choice((end, end, len(data)))]


def _insert(data: bytearray, rng: Random, others: Sequence[bytes]) -> None:
    """Repeat a part, or put one of another file in its place."""
    start, end = _span(data, rng)
    if rng.random() < 0.5:
        data[end:end] = bytes(data[start:end]) * rng.choice((1, 1, 2, 64))
    else:
        other = rng.choice(others)
        data[start:end] = other[slice(*_span(other, rng))]


def _integer(data: bytearray, rng: Random, _: Sequence[bytes]) -> None:
    kind = rng.choice(("<B", "<H", ">H", "<I", ">I", "<Q", ">Q"))
    size = struct.calcsize(kind)
    at = rng.randrange(max(len(data) - size, 0) + 1)
    data[at : at + size] = struct.pack(kind, rng.choice(INTERESTING) & (256**size - 1))


def _head(data: bytearray, rng: Random, others: Sequence[bytes]) -> None:
    """Damage the first bytes, in which formats keep what everything else depends on."""
    head = data[:256]
    rng.choice((_byte, _byte, _integer))(head, rng, others)
    data[: len(head)] = head


def _digit(data: bytearray, rng: Random, _: Sequence[bytes]) -> None:
    if digits := [i for i, byte in enumerate(data[:MOST_TEXT]) if chr(byte) in "0123456789"]:
        at = rng.choice(digits)
        data[at : at + 1] = rng.choice(DIGITS)


def _sign(data: bytearray, rng: Random, _: Sequence[bytes]) -> None:
    data[rng.randrange(len(data))] = ord(rng.choice(" \t\"'[]{}=,.:+-_#\\0aZ\n"))


def _line(data: bytearray, rng: Random, others: Sequence[bytes]) -> None:
    """Remove, repeat or move a line, or take one from another file."""
    lines, foreign = bytes(data).splitlines(keepends=True), rng.choice(others).splitlines(keepends=True) or [b"\n"]
    at, to = rng.randrange(len(lines)), rng.randrange(len(lines) + 1)
    often = min(100, MOST_BYTES // len(lines[at]))
    lines[to:to] = rng.choice(([], [lines[at]], [lines[at]] * often, [rng.choice(foreign)]))
    if rng.random() < 0.5:
        del lines[at]
    data[:] = b"".join(lines)


_CHANGES: tuple[Change, ...] = (_byte, _byte, _cut, _cut, _insert, _insert, _integer, _integer, _head, _head)
_OF_TEXTS: tuple[Change, ...] = (_digit, _digit, _digit, _sign, _line, _line)


def _is_text(data: bytes) -> bool:
    try:
        data.decode()
    except UnicodeDecodeError:
        return False
    return b"\0" not in data[:MOST_TEXT]


def _span(data: bytes | bytearray, rng: Random) -> tuple[int, int]:
    start = rng.randrange(len(data)) if data else 0
    return start, min(len(data), start + rng.choice((1, 2, 4, 16, 64, 1024, len(data))))


def with_checksums(png: bytes) -> bytes:
    """Correct the checksums of a PNG's chunks, without which decoders see no damage behind them."""
    result, at = bytearray(png), len(_PNG)
    while at + 12 <= len(result):
        (size,) = struct.unpack_from(">I", result, at)
        if at + 12 + size > len(result):
            break
        struct.pack_into(">I", result, at + 8 + size, zlib.crc32(result[at + 4 : at + 8 + size]))
        at += 12 + size
    return bytes(result)
