"""Reads and writes datasets: sessions of recordings in one JSON file (`priv/schema/dataset.schema.json`)."""

from __future__ import annotations

import copy
import json
import os
from typing import Any, Optional

from . import edits, reader
from .edits import ConflictError
from .reader import Path

__all__ = ["ConflictError", "Dataset", "Partition", "Session"]


class Dataset:
    """A dataset file. Saving keeps members that this package does not know, and merges the edits of other programs."""

    def __init__(self, path: Path, document: dict[str, Any]) -> None:
        self.path, self.document = os.fspath(path), document
        self._base = copy.deepcopy(document)

    @classmethod
    def create(cls, path: Path, name: Optional[str] = None) -> Dataset:
        """Creates a dataset file. Raises FileExistsError if the file exists."""
        if os.path.exists(path):
            raise FileExistsError(path)
        title = name or os.path.splitext(os.path.basename(path))[0]
        document = {"name": title, "tags": [], "metadata": {}, "sessions": []}
        edits.replace_file(os.fspath(path), _encode(document).encode())
        return cls(path, document)

    @classmethod
    def open(cls, path: Path) -> Dataset:
        """Opens a dataset file. Raises ValueError if it is not a dataset, or is of an unsupported version."""
        return cls(path, edits.Document(path, lambda value: _normalize(value, path)).content)

    @property
    def name(self) -> Optional[str]:
        """The dataset's name."""
        return self.document.get("name")

    @property
    def sessions(self) -> dict[str, Session]:
        """A dict from name to `Session`."""
        return {session["name"]: Session(self, session) for session in self.document["sessions"]}

    def add_session(self, name: str, **metadata: Any) -> Session:
        """Adds an empty session and returns it. Raises ValueError if the name is taken."""
        if name in self.sessions:
            raise ValueError(f"the dataset already has a session {name!r}")
        session = {"name": name, "tags": [], "metadata": metadata, "partitions": []}
        self.document["sessions"].append(session)
        return Session(self, session)

    def save(self) -> None:
        """Saves the edits. Edits that other programs have saved since are kept, and `document` then contains them.

        Raises `ConflictError` if another program has changed the same members differently.
        """
        if not os.path.exists(self.path):
            edits.replace_file(self.path, _encode(_normalize(self.document, self.path)).encode())
        changes = edits.diff(self._base, _normalize(self.document, self.path))
        document = edits.Document(self.path, lambda value: _normalize(value, self.path))
        document.edit(changes, _encode)
        if not edits.same(document.content, self.document):
            self.document = document.content
        self._base = copy.deepcopy(document.content)


def _normalize(document: Any, path: Path) -> dict[str, Any]:
    """Checks that a value is a dataset, and adds the members that files may omit."""
    if not isinstance(document, dict) or not isinstance(document.get("sessions"), list):
        raise ValueError(f"{path} is not a dataset: it has no list `sessions`")
    if document.get("version", 1) != 1:
        raise ValueError(f"{path} has version {document['version']}; this package supports version 1")
    normalized = {key: value for key, value in document.items() if key != "version"}
    normalized.setdefault("name", "Untitled Dataset")
    for owner in (normalized, *normalized["sessions"]):
        owner.setdefault("tags", [])
        owner.setdefault("metadata", {})
    for session in normalized["sessions"]:
        for part in session.setdefault("partitions", []):
            part.setdefault("metadata", {})
    return normalized


def _encode(document: dict[str, Any], mark: Optional[str] = None) -> str:
    """Returns the text of a file; `mark` is the text of its member `edits`."""
    document = dict(document)
    sessions = document.pop("sessions")
    text = json.dumps({"version": 1, **document, "sessions": sessions}, indent=2, ensure_ascii=False)
    return ("{\n  " + mark + "," + text[1:] if mark else text) + "\n"


class Session:
    """A session: a set of recordings that belong together."""

    def __init__(self, dataset: Dataset, document: Any) -> None:
        self._dataset, self.document = dataset, document

    @property
    def name(self) -> Optional[str]:
        name: Optional[str] = self.document["name"]
        return name

    @property
    def metadata(self) -> dict[str, Any]:
        """A dict of metadata, which can be changed in place."""
        metadata: dict[str, Any] = self.document.setdefault("metadata", {})
        return metadata

    @property
    def partitions(self) -> dict[str, Partition]:
        """A dict from name to `Partition`."""
        return {part["name"]: Partition(self._dataset, part) for part in self.document.get("partitions", [])}

    def add(self, path: Path, name: Optional[str] = None) -> Partition:
        """Adds a recording, by default under its own name. Raises ValueError if the name is taken."""
        store = reader.open(path)
        name = name or store.name
        if name in self.partitions:
            raise ValueError(f"the session already has a partition {name!r}")
        folder = os.path.dirname(os.path.abspath(self._dataset.path))
        relative = os.path.relpath(store.path, folder).replace(os.sep, "/")
        part = {"name": name, "store": store.name, "path": relative}
        self.document.setdefault("partitions", []).append(part)
        return Partition(self._dataset, part)


class Partition:
    """One recording of a session."""

    def __init__(self, dataset: Dataset, document: Any) -> None:
        self._dataset, self.document = dataset, document

    @property
    def name(self) -> Optional[str]:
        name: Optional[str] = self.document["name"]
        return name

    @property
    def path(self) -> str:
        """The recording's path, resolved against the dataset's folder."""
        folder = os.path.dirname(os.path.abspath(self._dataset.path))
        return os.path.normpath(os.path.join(folder, self.document["path"]))

    def open(self) -> reader.AnyStore:
        """Opens the recording. This package reads Situ's own store format only."""
        return reader.open(self.path)
