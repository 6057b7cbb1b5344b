"""Reads and writes datasets: sessions of recordings in one JSON file (`priv/schema/dataset.schema.json`)."""

from __future__ import annotations

import json
import os
import tempfile
from typing import Any, Optional

from . import reader
from .reader import Path


class Dataset:
    """A dataset file. Saving keeps members that this package does not know."""

    def __init__(self, path, document):
        self.path, self.document = os.fspath(path), document

    @classmethod
    def create(cls, path: Path, name: Optional[str] = None) -> Dataset:
        """Creates a dataset file. Raises FileExistsError if the file exists."""
        if os.path.exists(path):
            raise FileExistsError(path)
        title = name or os.path.splitext(os.path.basename(path))[0]
        dataset = cls(path, {"version": 1, "name": title, "tags": [], "metadata": {}, "sessions": []})
        dataset.save()
        return dataset

    @classmethod
    def open(cls, path: Path) -> Dataset:
        """Opens a dataset file. Raises ValueError if it is not a dataset, or is of an unsupported version."""
        with open(path, encoding="utf-8") as file:
            document = json.load(file)
        if not isinstance(document, dict) or not isinstance(document.get("sessions"), list):
            raise ValueError(f"{path} is not a dataset: it has no list `sessions`")
        if document.get("version", 1) != 1:
            raise ValueError(f"{path} has version {document['version']}; this package supports version 1")
        return cls(path, document)

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
        """Writes the file atomically."""
        folder = os.path.dirname(os.path.abspath(self.path))
        with tempfile.NamedTemporaryFile("w", dir=folder, delete=False, encoding="utf-8") as file:
            json.dump(self.document, file, indent=2, ensure_ascii=False)
            file.write("\n")
            file.flush()
            os.fsync(file.fileno())
        os.chmod(file.name, 0o644)
        os.replace(file.name, self.path)


class Session:
    """A session: a set of recordings that belong together."""

    def __init__(self, dataset, document):
        self._dataset, self.document = dataset, document

    @property
    def name(self) -> Optional[str]:
        return self.document["name"]

    @property
    def metadata(self) -> dict[str, Any]:
        """A dict of metadata, which can be changed in place."""
        return self.document.setdefault("metadata", {})

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

    def __init__(self, dataset, document):
        self._dataset, self.document = dataset, document

    @property
    def name(self) -> Optional[str]:
        return self.document["name"]

    @property
    def path(self) -> str:
        """The recording's path, resolved against the dataset's folder."""
        folder = os.path.dirname(os.path.abspath(self._dataset.path))
        return os.path.normpath(os.path.join(folder, self.document["path"]))

    def open(self) -> reader.AnyStore:
        """Opens the recording. This package reads Situ's own store format only."""
        return reader.open(self.path)
