"""Datasets: sessions of recordings in one JSON file (`priv/schema/dataset.schema.json`)."""

import json
import os
import tempfile

from . import reading


class Dataset:
    """A dataset file. Members this package does not know are kept when it is saved."""

    def __init__(self, path, document):
        self.path, self.document = os.fspath(path), document

    @classmethod
    def create(cls, path, name=None):
        """A new file; FileExistsError when there is one."""
        if os.path.exists(path):
            raise FileExistsError(path)
        title = name or os.path.splitext(os.path.basename(path))[0]
        dataset = cls(path, {"version": 1, "name": title, "tags": [], "metadata": {}, "sessions": []})
        dataset.save()
        return dataset

    @classmethod
    def open(cls, path):
        """Raises ValueError for what is no dataset, or one of a later version."""
        with open(path, encoding="utf-8") as file:
            document = json.load(file)
        if not isinstance(document, dict) or not isinstance(document.get("sessions"), list):
            raise ValueError(f"{path} is no dataset")
        if document.get("version", 1) != 1:
            raise ValueError(f"{path} is of version {document['version']}; this package reads 1")
        return cls(path, document)

    @property
    def name(self):
        return self.document.get("name")

    @property
    def sessions(self):
        """The sessions by name."""
        return {session["name"]: Session(self, session) for session in self.document["sessions"]}

    def add_session(self, name, **metadata):
        """A new, empty session; ValueError when there is one of that name."""
        if name in self.sessions:
            raise ValueError(f"there is a session {name!r} already")
        session = {"name": name, "tags": [], "metadata": metadata, "partitions": []}
        self.document["sessions"].append(session)
        return Session(self, session)

    def save(self):
        """Replaces the file, whole or not at all."""
        folder = os.path.dirname(os.path.abspath(self.path))
        with tempfile.NamedTemporaryFile("w", dir=folder, delete=False, encoding="utf-8") as file:
            json.dump(self.document, file, indent=2, ensure_ascii=False)
            file.write("\n")
            file.flush()
            os.fsync(file.fileno())
        os.chmod(file.name, 0o644)
        os.replace(file.name, self.path)


class Session:
    """A session: recordings that belong together."""

    def __init__(self, dataset, document):
        self._dataset, self.document = dataset, document

    @property
    def name(self):
        return self.document["name"]

    @property
    def metadata(self):
        return self.document.setdefault("metadata", {})

    @property
    def partitions(self):
        """The recordings by name."""
        return {part["name"]: Partition(self._dataset, part) for part in self.document.get("partitions", [])}

    def add(self, path, name=None):
        """Adds a recording, by default under its own name; ValueError when the session has one of that name."""
        store = reading.open(path)
        name = name or store.name
        if name in self.partitions:
            raise ValueError(f"there is a partition {name!r} already")
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
    def name(self):
        return self.document["name"]

    @property
    def path(self):
        folder = os.path.dirname(os.path.abspath(self._dataset.path))
        return os.path.normpath(os.path.join(folder, self.document["path"]))

    def open(self):
        """The store; this package reads Situ's own."""
        return reading.open(self.path)
