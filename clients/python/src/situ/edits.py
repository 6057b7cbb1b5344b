"""The log of edits of a JSON document, which several programs share (`Situ.EditLog` in Situ).

`DOCUMENT.edits` has one line for each operation: a CRC-32, a space, and a JSON object. The document names the version
that it contains. A program that edits a document takes `DOCUMENT.lock`, reads the operations of others, and appends its
own, which is on disk before `save` returns.
"""

from __future__ import annotations

import contextlib
import copy
import datetime
import getpass
import hashlib
import json
import os
import re
import secrets
import socket
import sys
import tempfile
import time
import zlib
from collections.abc import Iterator
from typing import Any, Callable, Optional

fcntl: Any
try:
    import fcntl
except ImportError:  # Windows has no such locks
    fcntl = None

MARK = re.compile(rb'"edits": \{"log": "[0-9a-f]{16}", "version": \d+, "offset": \d+, "digest": "([0-9a-f]{64})"\}')
ZEROS = b"0" * 64


class ConflictError(ValueError):
    """Another program has changed the same place differently."""


# Changes


def keyed(*lists: Any) -> bool:
    """Returns whether the lists have keys: objects with different names or ids, or different strings."""
    kinds = set()
    for items in lists:
        if not items:
            continue
        for kind in ("name", "id", "text"):
            try:
                keys = [item if kind == "text" else item[kind] for item in items]
            except (TypeError, KeyError, IndexError):
                continue
            if all(isinstance(k, str) for k in keys) and len(set(keys)) == len(keys):
                kinds.add(kind)
                break
        else:
            return False
    return len(kinds) == 1


def item_key(item: Any) -> Any:
    return item if isinstance(item, str) else item.get("name", item.get("id"))


def find(items: Any, key: bool) -> Optional[int]:
    return next((i for i, item in enumerate(items) if item_key(item) == key), None)


def same(a: Any, b: Any) -> bool:
    """Compares two JSON values; true is not 1."""
    return json.dumps(a, sort_keys=True) == json.dumps(b, sort_keys=True)


def diff(before: Any, later: Any, path: Any = ()) -> list[Any]:
    """Returns the changes that turn one document into another."""
    path = list(path)
    if same(before, later):
        return []
    if isinstance(before, dict) and isinstance(later, dict):
        changes = []
        for key in sorted({**before, **later}):
            if key not in later:
                changes.append(["remove", [*path, key], before[key], None])
            elif key not in before:
                changes.append(["add", [*path, key], later[key], None])
            else:
                changes += diff(before[key], later[key], [*path, key])
        return changes
    if isinstance(before, list) and isinstance(later, list) and keyed(before, later):
        return diff_items(before, later, path)
    return [["set", path, before, later]]


def diff_items(before: Any, later: Any, path: Any) -> list[Any]:
    old, new = {item_key(i): i for i in before}, {item_key(i): i for i in later}
    removes = [["remove", [*path, k], old[k], n] for n, k in enumerate(old) if k not in new]
    adds = [["add", [*path, k], new[k], n] for n, k in enumerate(new) if k not in old]
    inner = [change for k in old if k in new for change in diff(old[k], new[k], [*path, k])]
    keys = [k for k in old if k in new]
    for _, at, _, index in adds:
        keys.insert(index, at[-1])
    order = [] if keys == list(new) else [["order", path, keys, list(new)]]
    # An item that was added at the end stays at the end of what others have added.
    if not removes and [k for k in new if k in old] == list(new)[: len(old)]:
        adds = [[kind, at, value, None] for kind, at, value, _ in adds]
    return removes[::-1] + adds + inner + order


def apply_change(document: Any, change: Any, force: bool = False) -> Any:
    """Applies a change and returns the document. Raises ConflictError, or overwrites with `force`."""
    kind, path, a, b = change
    if not path:
        if kind == "order":
            items = {item_key(i): i for i in document}
            return [items[k] for k in b if k in items] + [i for i in document if item_key(i) not in b]
        if kind == "set" and (force or same(document, a) or same(document, b)):
            return b
        raise ConflictError
    key, rest, place = path[0], path[1:], document
    at: Any
    if isinstance(document, list):
        at = find(document, key)
    elif isinstance(document, dict):
        at = key if key in document else None
    else:
        raise ConflictError
    if rest or kind in ("set", "order"):
        if at is None:
            if not force:
                raise ConflictError
            if kind == "set" and not rest and isinstance(place, dict):
                place[key] = b
        else:
            place[at] = apply_change(place[at], [kind, rest, a, b], force)
        return place
    return apply_member(place, at, change, force)


def apply_member(place: Any, at: Any, change: Any, force: bool) -> Any:
    kind, (key,), a, b = change
    if kind == "rename":
        if at is not None and find(place, b) is None:
            place[at] = {**place[at], "name": b}
        elif at is not None or find(place, b) is None:
            raise ConflictError
        return place
    if at is not None and kind == "add" and not same(place[at], a):
        if not force:
            raise ConflictError
        place[at] = a
    elif at is None and kind == "add":
        if isinstance(place, dict):
            place[key] = a
        else:
            place.insert(len(place) if b is None else b, a)
    elif at is not None and kind == "remove":
        if not force and not same(place[at], a):
            raise ConflictError
        del place[at]
    return place


def describe(change: Any) -> str:
    return f"cannot merge the edit `{change[0]}` of {' / '.join(change[1])}: another program has changed it differently"


def apply_all(document: Any, changes: Any, force: bool = False) -> Any:
    for change in changes:
        try:
            document = apply_change(document, copy.deepcopy(change), force)
        except ConflictError:
            raise ConflictError(describe(change)) from None
    return document


# The log


def encode_line(value: Any) -> bytes:
    text = json.dumps(value, ensure_ascii=False, separators=(",", ":")).encode()
    return b"%08x %s\n" % (zlib.crc32(text), text)


def decode_line(line: bytes) -> Any:
    try:
        if line[8:9] == b" " and int(line[:8], 16) == zlib.crc32(line[9:]):
            return json.loads(line[9:])
    except ValueError:
        pass
    return None


def read_log(path: Any, mark: Any = None) -> Any:
    """Returns the header, the entries, and the offset after them; None without a log. `mark` skips earlier entries."""
    try:
        with open(path + ".edits", "rb") as file:
            first = file.readline()
            header = decode_line(first[:-1])
            if not isinstance(header, dict) or header.get("version") != 1:
                if not file.readline():
                    return None  # a crash while the log was created
                raise ValueError(f"the log of edits {path}.edits is damaged: it has no header")
            header["base"] = None
            number, offset = 1, len(first) + header["base_bytes"]
            if mark and mark.get("log") == header["log"] and mark["offset"] >= offset:
                number, offset = mark["version"] + 1, mark["offset"]
            else:
                header["base"] = (decode_line(file.readline()[:-1]) or {}).get("base")
            file.seek(offset)
            lines = file.read().split(b"\n")[:-1]
    except FileNotFoundError:
        return None
    entries = []
    for index, line in enumerate(lines):
        entry = decode_line(line)
        if not isinstance(entry, dict) or entry.get("n") != number + index:
            if index == len(lines) - 1:
                break  # a power failure can leave a line feed without its content
            raise ValueError(f"the log of edits {path}.edits is damaged at byte {offset}")
        offset += len(line) + 1
        entries.append(entry)
    return header, entries, offset


def entry_changes(entries: Any) -> list[Any]:
    return [change for entry in entries for change in entry["do"].get("changes", [])]


@contextlib.contextmanager
def lock(path: Any, wait: float = 30.0) -> Iterator[None]:
    """Holds the lock of a document. Raises TimeoutError with the holder."""
    if fcntl is None:
        raise OSError("datasets and annotations can be edited on Linux and macOS only: this system has no file locks")
    last = time.monotonic() + wait
    while True:
        file = os.open(path + ".lock", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = os.read(file, 4096).decode(errors="replace")
            os.close(file)
            if time.monotonic() > last:
                raise TimeoutError(f"{path} is being edited by {holder}") from None
            time.sleep(0.01)
            continue
        if is_at(path + ".lock", file):
            break
        os.close(file)
    try:
        os.ftruncate(file, 0)
        os.write(file, json.dumps({**author(), "os_pid": str(os.getpid())}).encode())
        yield
    finally:
        if is_at(path + ".lock", file):
            os.unlink(path + ".lock")
        os.close(file)


def is_at(path: Any, file: int) -> bool:
    try:
        there, here = os.lstat(path), os.fstat(file)
    except FileNotFoundError:
        return False
    return (there.st_dev, there.st_ino) == (here.st_dev, here.st_ino)


def author() -> dict[str, Any]:
    try:
        user = getpass.getuser()
    except (KeyError, OSError):
        user = None
    now = datetime.datetime.now(datetime.timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")
    program = os.path.basename(sys.argv[0]) or "Python"
    return {"user": user, "host": socket.gethostname(), "program": program, "since": now}


def sync_folder(path: Any) -> None:
    folder = os.open(os.path.dirname(os.path.abspath(path)), os.O_RDONLY)
    try:
        os.fsync(folder)
    except OSError:
        pass  # some network file systems do not support it
    finally:
        os.close(folder)


def read_bytes(path: Any) -> bytes:
    with open(path, "rb") as file:
        return file.read()


def replace_file(path: Any, content: bytes) -> None:
    folder = os.path.dirname(os.path.abspath(path))
    prefix = os.path.basename(path) + "."
    with tempfile.NamedTemporaryFile(dir=folder, prefix=prefix, suffix=".tmp", delete=False) as file:
        try:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
            os.chmod(file.name, 0o644)
            os.replace(file.name, path)
        except BaseException:
            os.unlink(file.name)
            raise
    sync_folder(path)


def append_line(path: Any, offset: int, line: bytes) -> None:
    """Appends a line at the end of the complete lines. The file is unchanged if that fails."""
    with open(path + ".edits", "r+b", buffering=0) as file:
        try:
            file.truncate(offset)
            file.seek(offset)
            if file.write(line) != len(line):
                raise OSError("no space left on device")
            os.fsync(file.fileno())
        except OSError:
            file.truncate(offset)
            raise


# Documents


def digest_of(text: bytes) -> str:
    found = MARK.search(text)
    if found:
        text = text[: found.start(1)] + ZEROS + text[found.end(1) :]
    return hashlib.sha256(text).hexdigest()


class Document:
    """A JSON file and its log. `normalize` fills in members that files may omit."""

    def __init__(self, path: Any, normalize: Callable[[Any], Any]) -> None:
        self.path, self.normalize = os.fspath(path), normalize
        self.read()

    def read(self) -> None:
        """Reads the current content. Edits of the file itself get into the log with the next edit."""
        for _ in range(100):
            self.text = read_bytes(self.path)
            value = json.loads(self.text)
            mark: Any = value.pop("edits", None) if isinstance(value, dict) else None
            digest = digest_of(self.text)
            intact = isinstance(mark, dict) and mark.get("digest") == digest
            self.content = self.normalize(value)
            self.outside: list[Any] = []
            self.log = read_log(self.path, mark if intact else None)
            if self.log is None:
                self.version = self.file = 0
                return
            header, entries, _ = self.log
            if intact and mark.get("log") == header["log"]:
                self.file = mark["version"]
                self.version = self.file + len(entries)
                if all(entry.get("file", 0) <= self.file for entry in entries):
                    self.content = apply_all(self.content, entry_changes(entries))
                    return
            # Unless another program has just written the file, somebody has edited it or put an older one back.
            if read_bytes(self.path) == self.text:
                break
        self.log = read_log(self.path)
        self.file, self.version = 0, len(self.log[1])
        self.merge_file({} if intact or not isinstance(mark, dict) else mark, digest)

    def merge_file(self, mark: Any, digest: str) -> None:
        """Merges a file that does not contain what the log says: somebody has edited it, or replaced it."""
        header, entries, _ = self.log
        file, self.content = self.content, apply_all(copy.deepcopy(header["base"]), entry_changes(entries))
        outside = [entry for entry in entries if entry["kind"] == "outside"][-1:]
        # A program that took over these edits was killed before it wrote the file.
        adopted = outside and outside[0].get("of") == digest
        adopted = adopted and all(e.get("file", 0) < outside[0]["n"] for e in entries[outside[0]["n"] :])
        first = not mark and header.get("digest") == digest and all(e.get("file", 0) == 0 for e in entries)
        if first or adopted:
            return
        before = copy.deepcopy(self.content)
        base = before
        if mark.get("log") == header["log"]:
            base = apply_all(copy.deepcopy(header["base"]), entry_changes(entries[: mark["version"]]))
        self.content = apply_all(self.content, diff(base, file), force=True)
        self.outside = diff(before, self.content)

    def edit(self, changes: Any, encode: Callable[..., str]) -> None:
        """Applies changes to the current content and saves it. Raises ConflictError if they do not fit."""
        with lock(self.path):
            self.read()
            before = copy.deepcopy(self.content)
            content = apply_all(self.content, changes)
            effective = diff(before, content)
            if self.log is None and effective:
                self.create_log(before)
            if self.log is None:
                return
            if self.outside:
                more = {"user": None, "program": "an editor of the file", "of": digest_of(self.text)}
                self.append("outside", self.outside, more)
            if effective:
                self.append("edit", effective, {})
            self.content = content
            header, _, offset = self.log
            mark = {"log": header["log"], "version": self.version, "offset": offset, "digest": ZEROS.decode()}
            text = encode(content, '"edits": ' + json.dumps(mark)).encode()
            found: Any = MARK.search(text)
            text = text[: found.start(1)] + digest_of(text).encode() + text[found.end(1) :]
            replace_file(self.path, text)

    def create_log(self, base: Any) -> None:
        second = encode_line({"base": base})
        header = {"log": secrets.token_hex(8), "version": 1, "base_bytes": len(second), "digest": digest_of(self.text)}
        lines = encode_line(header) + second
        replace_file(self.path + ".edits", lines)
        self.log = header, [], len(lines)

    def append(self, kind: str, changes: Any, more: dict[str, Any]) -> None:
        header, entries, offset = self.log
        me = author()
        entry = {"n": self.version + 1, "kind": kind, "at": me.pop("since"), **me, **more, "file": self.file}
        entry["do"] = {"changes": changes}
        line = encode_line({key: value for key, value in entry.items() if value is not None})
        append_line(self.path, offset, line)
        self.version += 1
        self.log = header, [*entries, entry], offset + len(line)
