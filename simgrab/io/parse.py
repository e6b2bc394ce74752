"""Read users' text files: one reader of text, and one parser each for TOML, JSON and YAML.

Every defect is reported in one line with the file and the reason: a folder, a pipe or a device in the file's place,
bytes that are not UTF-8, endless nesting, numbers beyond 64 bits. A byte order mark is skipped.
"""

from __future__ import annotations

import contextlib
import errno
import functools
import json
import math
import os
import re
import stat
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from datetime import date, time
from io import BufferedReader
from pathlib import Path
from typing import Any

from simgrab.errors import SimgrabError, first_line, one_line

Refuse = Callable[[str], SimgrabError]

MOST_BYTES = 16 * 2**20
"""Of a JSON file that simgrab writes about a dataset, a run, a suite or a study."""
MOST_TOML_BYTES = 4 * 2**20
"""Of a TOML file that a person writes: a scene, a camera, a suite … The parser takes seconds for so much."""
MOST_LEVELS = 64
"""Of tables and lists within each other."""
_MOST_GROWTH = 2**20  # bytes of a file, while it is read
MOST_SHOWN = 80  # characters of a value in a message
LEAST_INTEGER, MOST_INTEGER = -(2**63), 2**63 - 1

_KINDS = {
    stat.S_IFREG: "a file", stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device", stat.S_IFBLK: "a device",
}  # fmt: skip


def read_toml(path: str | Path, refuse: Refuse, kind: str = "") -> dict[str, Any]:
    """Read a TOML file; ``refuse`` makes the error to raise from a line with file and reason.

    ``kind`` is the name of this kind of file in messages, e.g. ``"camera file"``.
    """
    text = read_text(path, refuse, kind, most_bytes=MOST_TOML_BYTES)
    return parse_toml(text, refuse, f"{cannot(path, kind)}: it is not valid TOML")


def read_json(path: str | Path, refuse: Refuse, kind: str = "", *, most_bytes: int = MOST_BYTES) -> Any:
    """Read a JSON file; parameters as for `read_toml`, and the greatest size in bytes."""
    text = read_text(path, refuse, kind, most_bytes=most_bytes)
    return parse_json(text, refuse, f"{cannot(path, kind)}: it is not valid JSON")


def read_yaml(path: str | Path, refuse: Refuse, kind: str = "", *, most_bytes: int) -> Any:
    """Read a YAML file; parameters as for `read_json`. Its lists and mappings may contain themselves."""
    from yaml import YAMLError, safe_load

    text = read_text(path, refuse, kind, most_bytes=most_bytes)
    try:
        return safe_load(text)
    # Beside errors of its own, the parser lets through what Python raises for values such as ``!!bool x``.
    except (YAMLError, ValueError, LookupError, ArithmeticError, AttributeError, RecursionError) as problem:
        raise refuse(f"{cannot(path, kind)}: it is not valid YAML ({first_line(problem)})") from None


def read_text(path: str | Path, refuse: Refuse, kind: str = "", *, most_bytes: int = MOST_BYTES) -> str:
    """Read a text file, UTF-8 with or without a byte order mark; parameters as for `read_json`."""
    data = read_bytes(path, refuse, kind, most_bytes=most_bytes)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        raise refuse(
            f"{cannot(path, kind)}: it is not UTF-8 text (byte {problem.start + 1}: {problem.reason})"
        ) from None


def read_bytes(path: str | Path, refuse: Refuse, kind: str = "", *, most_bytes: int) -> bytes:
    """Read a regular file; parameters as for `read_json`."""
    with opened(path, refuse, kind, most_bytes=most_bytes) as file:
        # Memory is taken for as much as is asked for. A file may grow meanwhile, and one in /proc states no size.
        most = min(most_bytes, os.fstat(file.fileno()).st_size + _MOST_GROWTH)
        data = file.read(most + 1)
    if len(data) > most:
        raise refuse(f"{cannot(path, kind)}: it holds more than {_size(most)}")
    return data


@contextlib.contextmanager
def opened(path: str | Path, refuse: Refuse, kind: str = "", *, most_bytes: int) -> Iterator[BufferedReader]:
    """Open a regular file to read bytes; never waits for a pipe."""
    what = cannot(path, kind)
    try:
        file = open(path, "rb", opener=_open_at_once)  # noqa: SIM115
    except (OSError, ValueError) as problem:  # ValueError: a name with a NUL byte
        raise refuse(f"{what}: {why_not_read(path, problem)}") from None
    with file:
        about = os.fstat(file.fileno())
        if not stat.S_ISREG(about.st_mode):
            raise refuse(f"{what}: it is {kind_of(about.st_mode)}, not a file")
        if about.st_size > most_bytes:
            raise refuse(f"{what}: it is {_size(about.st_size)}; the limit is {_size(most_bytes)}")
        try:
            yield file
        except OSError as problem:
            raise refuse(f"{what}: {first_line(problem)}") from None


def _open_at_once(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_NONBLOCK)  # a pipe without a writer would block until there is one


def is_file(path: str | Path, refuse: Refuse) -> bool:
    """Whether a path is a regular file, or a link to one; raises an error if that cannot be determined."""
    return stat.S_ISREG(_mode(path, refuse))


def is_dir(path: str | Path, refuse: Refuse) -> bool:
    """Whether a path is a folder, or a link to one; raises an error if that cannot be determined."""
    return stat.S_ISDIR(_mode(path, refuse))


def _mode(path: str | Path, refuse: Refuse) -> int:
    """Mode of the file at a path; 0 if there is none."""
    try:
        return Path(path).stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return 0
    except (OSError, ValueError) as problem:  # a name that is too long, a folder that may not be searched, a NUL byte
        raise refuse(f"{cannot(path)}: {first_line(problem)}") from None


def cannot(path: str | Path, kind: str = "") -> str:
    """Begin the error line of a file that cannot be read."""
    return " ".join(filter(None, ("cannot read", kind, str(path))))


def kind_of(mode: int) -> str:
    """Name the kind of a file from its mode."""
    return _KINDS.get(stat.S_IFMT(mode), "something else")


def why_not_read(path: str | Path, problem: Exception) -> str:
    """Say why a file could not be opened."""
    if isinstance(problem, OSError) and problem.errno == errno.ENOENT and Path(path).is_symlink():
        return f"it is a link to {os.readlink(path)}, which does not exist"  # noqa: PTH115
    if isinstance(problem, OSError) and problem.errno == errno.EISDIR:
        return "it is a folder, not a file"
    if isinstance(problem, OSError) and problem.errno == errno.ENXIO:
        return "it is a socket or a device, not a file"
    return first_line(problem)


def parse_toml(text: str, refuse: Refuse, what: str) -> dict[str, Any]:
    """Parse TOML; ``what`` begins the error line."""
    return dict(_parse(_loads_toml, text, refuse, what))


def parse_value(text: str, refuse: Refuse, what: str) -> Any:
    """Parse one value as TOML. A date, or a line that is not TOML, is taken as text."""
    try:
        data = _loads_toml(f"v = {text}")
    except tomllib.TOMLDecodeError:
        data = {"v": text} if len(text.splitlines()) <= 1 else {}
    except (RecursionError, ValueError):  # too deep, or thousands of digits
        data = parse_toml(f"v = {text}", refuse, what)
    if list(data) != ["v"]:
        raise refuse(f"{what} takes one value, got {shown(text)}")
    return text if isinstance(data["v"], date | time) else data["v"]


def _loads_toml(text: str) -> dict[str, Any]:
    if _LONG_KEY.search(text):  # for which the parser takes time by the square of its length
        raise RecursionError("a dotted key has too many parts")
    return tomllib.loads(text)


def parse_json(text: str | bytes, refuse: Refuse, what: str) -> Any:
    """Parse JSON, in which no table may have a key twice; ``what`` begins the error line."""
    return _parse(functools.partial(json.loads, object_pairs_hook=_unique), text, refuse, what)


def _parse(parse: Callable[[Any], Any], text: str | bytes, refuse: Refuse, what: str) -> Any:
    try:
        data = parse(text)
    except RecursionError:
        raise refuse(f"{what}: {_TOO_DEEP}") from None
    except ValueError as problem:  # of both parsers, of int() where there are thousands of digits, and of UTF-8
        reason = f"a number must have {_MOST_DIGITS}" if "integer string conversion" in str(problem) else problem
        raise refuse(f"{what}: {one_line(reason)}") from None
    if misfit := find_misfit(data):
        raise refuse(f"{what}: {': '.join(filter(None, misfit))}")
    return data


_LONG_KEY = re.compile(
    r"""(?:^|[\[{,])[ \t]*+(?:(?:"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+'|[\w-]++)[ \t]*+\.[ \t]*+){200}""", re.MULTILINE
)
_MOST_DIGITS = "64 bits at most"
_TOO_DEEP = f"tables and lists must not be nested deeper than {MOST_LEVELS} levels"


def find_misfit(data: Any, *, finite: bool = False) -> tuple[str, str] | None:
    """Find a value that simgrab's files cannot store: returns its dotted key and the problem, or None.

    Such values are integers beyond 64 bits, nesting beyond `MOST_LEVELS`, and texts or keys with lone surrogates. These
    come from JSON escapes and from arguments that are not UTF-8. With ``finite``, infinite numbers and NaN are found
    too.
    """
    left: list[tuple[Any, tuple[str, ...]]] = [([data], ())]
    while left:
        table, path = left.pop()
        for key, value in table.items() if isinstance(table, Mapping) else enumerate(table):
            if isinstance(key, str) and not _is_unicode(key):
                return _dotted((*path, key)), "a key must be UTF-8 text"
            if isinstance(value, str):
                if not _is_unicode(value):
                    return _dotted((*path, str(key))), f"must be UTF-8 text, got {shown(value)}"
            elif isinstance(value, int):
                if not LEAST_INTEGER <= value <= MOST_INTEGER:
                    return _dotted((*path, str(key))), f"an integer must have {_MOST_DIGITS}"
            elif isinstance(value, float):
                if finite and not math.isfinite(value):
                    return _dotted((*path, str(key))), f"must be a finite number, got {value}"
            elif isinstance(value, (list, tuple, Mapping)):
                if len(path) >= MOST_LEVELS:
                    return _dotted(path[:4]), _TOO_DEEP
                left.append((value, (*path, str(key))))
    return None


def _is_unicode(text: str) -> bool:
    if text.isascii():
        return True
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def _dotted(path: tuple[str, ...]) -> str:
    return ".".join(path[1:])  # the first is the place of the whole


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) < len(pairs):
        counts = Counter(key for key, _ in pairs)
        raise ValueError(f"duplicate key {next(key for key, count in counts.items() if count > 1)!r}")
    return table


def shown(value: Any) -> str:
    """Write a value for a message; a long one is shortened."""
    text = repr(value)
    return text if len(text) <= MOST_SHOWN else f"{text[:MOST_SHOWN]}…"


def _size(size: int) -> str:
    return f"{size / 2**20:.0f} MiB" if size >= 2**20 else f"{size} bytes"
