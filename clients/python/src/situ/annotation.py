"""Reads and edits annotations together with the studio and other programs, through the same log of edits.

    layer = situ.annotations("recordings/lobby", "Speech")
    for annotation in layer:
        print(annotation.start, annotation.end, annotation.track, annotation.values)

    layer.add(start, end, "P1", {"Speech": "laughs"}, by="my model", confidence=0.8, proposed=True)

Every edit is on disk when it returns. The studio shows it within two seconds, and stores it in the next version of the
layer. `situ annotate undo` undoes it.
"""

from __future__ import annotations

import base64
import contextlib
import dataclasses
import math
import operator
import os
import re
import urllib.parse
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Optional, Union

from . import edits, reader, segments, terms, writer
from .dataset import Session
from .edits import ConflictError
from .reader import Path

__all__ = ["Annotation", "Batch", "Layer", "layers", "open_layer"]

_TYPE = "{:list, Situ.Annotation}"
_SPATIAL = ("start", "end", "track")
_EMPTY: dict[str, Any] = {"text": "", "number": 0, "bool": False}

@dataclasses.dataclass(frozen=True)
class Annotation:
    """A statement about a span of time. Times are nanoseconds; `start` and `end` are equal for a point in time."""

    start: int
    end: int
    track: str
    values: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    id: int = 0
    by: Optional[str] = None
    confidence: Optional[float] = None
    note: Optional[str] = None
    proposed: bool = False


_FIELDS = tuple(field.name for field in dataclasses.fields(Annotation) if field.name != "id")
Recording = Union[Path, "reader.Store", "segments.SegmentedStore", Session]


def open_layer(recording: Recording, name: str, schema: Optional[Mapping[str, Any]] = None) -> Layer:
    """Opens a layer of annotations of a recording or of a session of a dataset.

    `recording` is a path, an open store, a `Session`, or the path of a store of annotations. With `schema`
    (`{"name": ..., "attributes": [{"name": ..., "kind": "text"}]}`, see `priv/schema/annotation.schema.json`), a layer of
    a recording that does not exist is created. Raises FileNotFoundError if it does not exist, `Damaged`, and ValueError.
    """
    store = _find_store(recording, name)
    if store is None:
        if schema is None or isinstance(recording, Session):
            raise FileNotFoundError(f"{_describe(recording)} has no layer {name!r}: create it in the studio")
        store = _create_layer(_recording_path(recording), name, schema)
    return Layer(store, name)


def layers(recording: Recording) -> list[str]:
    """Returns the names of the layers of a recording or session that can be edited."""
    return sorted({name for store in _list_stores(recording) for name in _list_streams(store)})


def _describe(recording: Recording) -> str:
    if isinstance(recording, Session):
        return f"session {recording.name!r}"
    return _recording_path(recording)


def _recording_path(recording: Any) -> str:
    if isinstance(recording, (str, os.PathLike)):
        recording = reader.open(recording)
    path: str = os.path.abspath(recording.path)
    return path


def _list_stores(recording: Recording) -> list[str]:
    if isinstance(recording, Session):
        paths = (part.path for part in recording.partitions.values())
        stores = (re.sub(r"\.\d{4,}$", "", path) for path in paths)
        return [store for store in stores if os.path.basename(store) == "annotations"]
    path = _recording_path(recording)
    own = re.sub(r"\.\d{4,}$", "", path)
    if any(stream.type == _TYPE for stream in reader.open(path).streams.values()):
        return [own]
    start, folder = os.path.basename(path) + "-annotation-", os.path.dirname(path)
    names = (re.fullmatch(r"(.+)\.\d{4,}", name) for name in sorted(os.listdir(folder)) if name.startswith(start))
    return sorted({os.path.join(folder, found[1]) for found in names if found})


def _list_streams(store: str) -> list[str]:
    folders = _list_versions(store)
    return list(reader.open(folders[0]).streams) if folders else []


def _find_store(recording: Recording, name: str) -> Optional[str]:
    return next((store for store in _list_stores(recording) if name in _list_streams(store)), None)


def _list_versions(store: str) -> list[str]:
    """Returns the folders of the versions of a store, newest first."""
    folder, base = os.path.split(os.path.abspath(store))
    names = [name for name in os.listdir(folder) if re.fullmatch(re.escape(base) + r"\.\d{4,}", name)]
    names = [name for name in names if os.path.exists(os.path.join(folder, name, "index.situ"))]
    if not names and os.path.exists(os.path.join(store, "index.situ")):
        return [store]
    names.sort(key=lambda name: (len(name), name), reverse=True)
    return [os.path.join(folder, name) for name in names]


def _create_layer(path: str, name: str, schema: Mapping[str, Any]) -> str:
    _check_schema(schema)
    escaped = urllib.parse.quote(name, safe="").replace(".", "%2E")
    store = f"{path}-annotation-{escaped}"
    with edits.lock(_document(store, name)):
        if not _list_versions(store):
            with writer.create(os.path.basename(store), os.path.dirname(store), core=False) as new:
                new.open(name, _TYPE)
                term = base64.b64encode(terms.encode_term(dict(schema))).decode()
                new._add_record({"kind": "metadata", "id": 1, "type": ":map", "term": term})
    return store


def _document(store: str, name: str) -> str:
    return store + "." + re.sub(r"[^\w.-]", "_", name)


def _check_schema(schema: Mapping[str, Any]) -> None:
    attributes = schema.get("attributes")
    if not isinstance(schema.get("name"), str) or not isinstance(attributes, list) or not attributes:
        raise ValueError("a schema has a name and a list of attributes")
    for attribute in attributes:
        kind = attribute.get("kind") if isinstance(attribute, dict) else None
        if kind not in ("finite", "text", "number", "bool") or not isinstance(attribute.get("name"), str):
            raise ValueError(f"attribute {attribute!r} needs a name and a kind: finite, text, number or bool")
        if kind == "finite" and not attribute.get("values"):
            raise ValueError(f"attribute {attribute['name']!r} is finite and needs values")


class _State:
    """The layer after an operation of its log."""

    def __init__(self, schema: dict[str, Any], items: Iterable[Annotation], next_id: int) -> None:
        self.schema, self.items = schema, {item.id: item for item in items}
        self.next_id = max([next_id, *(item.id + 1 for item in self.items.values())])

    def copy(self) -> _State:
        return _State(self.schema, self.items.values(), self.next_id)

    def apply_entry(self, entry: dict[str, Any]) -> None:
        schema = entry["do"].get("schema")
        if schema:
            self.schema = schema[1]
        for id, _, later in entry["do"].get("annotations", []):
            self.next_id = max(self.next_id, id + 1)
            if later is None:
                self.items.pop(id, None)
            else:
                self.items[id] = _from_json({**later, "id": id})


class Layer:
    """A layer of annotations: a sequence in the order of time. `refresh` reads the edits of other programs."""

    def __init__(self, store: str, name: str) -> None:
        self.name, self._store, self._document = name, store, _document(store, name)
        self._versions: list[str] = []
        self._outside: list[str] = []
        self._log: Any = None
        self._state, self._log, self.version = self._read()

    @property
    def schema(self) -> dict[str, Any]:
        """The schema in its JSON form."""
        return self._state.schema

    def __iter__(self) -> Iterator[Annotation]:
        return iter(sorted(self._state.items.values(), key=lambda a: (a.start, a.end, a.track)))

    def __len__(self) -> int:
        return len(self._state.items)

    def __getitem__(self, id: int) -> Annotation:
        """Returns the annotation with this id. Raises KeyError."""
        return self._state.items[id]

    def refresh(self) -> None:
        """Reads the edits that other programs have made since."""
        self._state, self._log, self.version = self._read()

    def add(
        self,
        start: int,
        end: int,
        track: str,
        values: Optional[Mapping[str, Any]] = None,
        *,
        by: Optional[str] = None,
        confidence: Optional[float] = None,
        note: Optional[str] = None,
        proposed: bool = False,
    ) -> Annotation:
        """Adds an annotation; missing values get their defaults. Raises ValueError if it breaks a rule of the layer."""
        with self.edit(by) as batch:
            batch.add(start, end, track, values, by=by, confidence=confidence, note=note, proposed=proposed)
        return self._state.items[batch.ids[0]]

    def change(self, id: int, *, editor: Optional[str] = None, **fields: Any) -> Annotation:
        """Changes fields of an annotation, such as `end=...` or `values={...}` (which are merged).

        Raises `ConflictError` if another program has changed the same fields since they were read, or has deleted the
        annotation; `refresh` then shows its edit. `editor` is the person in the history.
        """
        with self.edit(editor) as batch:
            batch.change(id, **fields)
        return self._state.items[id]

    def remove(self, id: int, *, editor: Optional[str] = None) -> None:
        """Deletes an annotation. Raises `ConflictError` if another program has changed it since it was read."""
        with self.edit(editor) as batch:
            batch.remove(id)

    @contextlib.contextmanager
    def edit(self, by: Optional[str] = None) -> Iterator[Batch]:
        """Collects edits in a `with` statement, and makes all of them as one operation, or none."""
        batch = Batch()
        yield batch
        if batch._steps:
            self._apply(batch, by)

    def _apply(self, batch: Batch, by: Optional[str]) -> None:
        with edits.lock(self._document):
            before, log, version = self._read(check=True)
            after = before.copy()
            batch.ids = []
            for step in batch._steps:
                batch.ids.append(_apply_step(step, self._state, after, batch.ids))
            changed = [id for id in sorted({*batch.ids}) if before.items.get(id) != after.items.get(id)]
            if changed:
                _check_rules(before, after, changed)
                changes = [[id, _to_json(before.items.get(id)), _to_json(after.items.get(id))] for id in changed]
                log = self._append(log, version, {"annotations": changes}, by)
                version += 1
            self._state, self._log, self.version = after, log, version

    def _append(self, log: Any, version: int, operation: dict[str, Any], by: Optional[str]) -> Any:
        header, offset = log if log else self._create_log()
        me = edits.author()
        entry = {"n": version + 1, "kind": "edit", "at": me.pop("since"), "by": by, **me, "do": operation}
        line = edits.encode_line({key: value for key, value in entry.items() if value is not None})
        edits.append_line(self._document, offset, line)
        return header, offset + len(line)

    def _create_log(self) -> Any:
        base = os.path.basename(_list_versions(self._store)[0])
        header = {"log": os.urandom(8).hex(), "version": 1, "base_bytes": 0, "base": base}
        line = edits.encode_line(header)
        edits.replace_file(self._document + ".edits", line)
        return header, len(line)

    def _read(self, check: bool = False) -> tuple[_State, Any, int]:
        """Returns the state, the header and size of the log, and its number of operations."""
        for _ in range(100):
            header, versions = _read_header(self._document), _list_versions(self._store)
            found = self._read_new(header, versions) or self._read_all(header, versions)
            if found:
                if check and self._outside:
                    raise ConflictError(
                        f"{self._outside[0]} was written by a program without a log of edits: open the layer in the "
                        f"studio, or run `situ annotate history`, to merge it"
                    )
                return found
        raise TimeoutError(f"{self._document}.edits is being replaced again and again")

    def _read_new(self, header: Any, versions: list[str]) -> Optional[tuple[_State, Any, int]]:
        """Reads only the entries after the last ones, if there is no new version of the store."""
        if not self._log or header is None or header["log"] != self._log[0]["log"] or versions != self._versions:
            return None
        mark = {"log": header["log"], "version": self.version, "offset": self._log[1]}
        _, entries, offset = edits.read_log(self._document, mark)
        state = self._state.copy()
        for entry in entries:
            state.apply_entry(entry)
        return state, (header, offset), self.version + len(entries)

    def _read_all(self, header: Any, versions: list[str]) -> Optional[tuple[_State, Any, int]]:
        start, outside = _find_start(versions, self.name, header)
        if start is None and (header is None or header.get("base") is not None):
            raise FileNotFoundError(f"the layer {self.name!r} in {self._store} does not exist any more")
        state = _load_state(start, self.name) if start else _State((header or {}).get("schema", {}), [], 1)
        self._versions, self._outside = versions, []
        if header is None:
            return state, None, 0
        mark = _read_mark(start, self.name, header) if start else None
        found = edits.read_log(self._document, mark)
        # Another program may have written a new version or a new log in between.
        if found is None or found[0]["log"] != header["log"]:
            return None
        _, entries, offset = found
        for entry in entries:
            state.apply_entry(entry)
        taken = {entry.get("of") for entry in entries if entry["kind"] == "outside"}
        self._outside = [folder for folder in outside if os.path.basename(folder) not in taken]
        return state, (header, offset), (mark["version"] if mark else 0) + len(entries)


class Batch:
    """Edits that are made together, see `Layer.edit`. Afterwards, `ids` has the id of the annotation of each edit."""

    def __init__(self) -> None:
        self._steps: list[tuple[str, Any]] = []
        self.ids: list[int] = []

    def add(
        self,
        start: int,
        end: int,
        track: str,
        values: Optional[Mapping[str, Any]] = None,
        *,
        by: Optional[str] = None,
        confidence: Optional[float] = None,
        note: Optional[str] = None,
        proposed: bool = False,
    ) -> None:
        """Adds an annotation."""
        start, end = operator.index(start), operator.index(end)
        new = Annotation(start, end, track, dict(values or {}), 0, by, confidence, note, proposed)
        self._steps.append(("add", new))

    def change(self, id: int, **fields: Any) -> None:
        """Changes fields of an annotation."""
        if not fields or set(fields) - set(_FIELDS):
            raise TypeError(f"an annotation has the fields {', '.join(_FIELDS)}")
        fields = {name: operator.index(fields[name]) if name in ("start", "end") else fields[name] for name in fields}
        self._steps.append(("change", (id, fields)))

    def remove(self, id: int) -> None:
        """Deletes an annotation."""
        self._steps.append(("remove", id))


def _apply_step(step: tuple[str, Any], seen: _State, state: _State, ids: list[int]) -> int:
    """Applies an edit to a state. `seen` is the state that the caller has seen, `ids` are of the edits before it."""
    kind, what = step
    if kind == "add":
        values = {**_default_values(state.schema, what.track), **what.values}
        state.items[state.next_id] = dataclasses.replace(what, id=state.next_id, values=values)
        state.next_id += 1
        return state.next_id - 1
    id: int = what if kind == "remove" else what[0]
    fields: dict[str, Any] = {} if kind == "remove" else what[1]
    now = state.items.get(id)
    if id not in ids:
        if id not in seen.items:
            raise KeyError(id)
        _check_unchanged(seen.items[id], now, list(fields) or list(_FIELDS))
    if now is None:
        raise KeyError(id)
    if kind == "remove":
        del state.items[id]
        return id
    if "values" in fields:
        fields = {**fields, "values": {**now.values, **fields["values"]}}
    state.items[id] = dataclasses.replace(now, **fields)
    return id


def _check_unchanged(seen: Annotation, now: Optional[Annotation], fields: list[str]) -> None:
    # The start, the end and the track depend on each other.
    names = {*fields, *_SPATIAL} if set(fields) & set(_SPATIAL) else fields
    if now is None or any(getattr(now, name) != getattr(seen, name) for name in names):
        raise ConflictError(f"annotation {seen.id} was changed by another program: refresh the layer, and edit again")


def _find_start(versions: list[str], name: str, header: Any) -> tuple[Optional[str], list[str]]:
    """Returns the newest version that the log knows, and the later ones of programs without the log."""
    outside: list[str] = []
    for folder in versions:
        stream = reader.open(folder).streams.get(name)
        if stream is None:
            continue
        mark = _stream_mark(stream)
        if header is None or mark.get("log") == header["log"] or header.get("base") == os.path.basename(folder):
            return folder, outside
        outside.append(folder)
    return None, outside


def _stream_mark(stream: reader.Stream) -> dict[str, Any]:
    mark = stream.metadata.get("edits") if isinstance(stream.metadata, dict) else None
    return mark if isinstance(mark, dict) else {}


def _read_mark(folder: str, name: str, header: Any) -> Optional[dict[str, Any]]:
    mark = _stream_mark(reader.open(folder).streams[name])
    return mark if mark.get("log") == header["log"] else None


def _read_header(document: str) -> Any:
    try:
        with open(document + ".edits", "rb") as file:
            header = edits.decode_line(file.readline()[:-1])
    except FileNotFoundError:
        return None
    return header if isinstance(header, dict) else None


def _load_state(folder: str, name: str) -> _State:
    store = reader.open(folder)
    metadata = store.streams[name].metadata
    if not isinstance(metadata, dict) or not metadata.get("attributes"):
        raise ValueError(f"the stream {name!r} of {folder} has no schema: open it in the studio first")
    schema = {key: value for key, value in metadata.items() if key not in ("edits", "review")}
    items = [_from_struct(item) for message in store.read(name) for item in message.data]
    reviewed = [int(id) for id in metadata.get("review", {})]
    return _State(schema, items, max(reviewed, default=0) + 1)


def _from_struct(item: Any) -> Annotation:
    return _from_json({str(key).rstrip("?"): value for key, value in item.items()})


def _from_json(json: dict[str, Any]) -> Annotation:
    return Annotation(
        json["from"],
        json["to"],
        json["track"],
        json.get("values") or {},
        json.get("id") or 0,
        json.get("by"),
        json.get("confidence"),
        json.get("note"),
        bool(json.get("proposed")),
    )


def _to_json(item: Optional[Annotation]) -> Optional[dict[str, Any]]:
    if item is None:
        return None
    json = {"id": item.id, "from": item.start, "to": item.end, "track": item.track, "values": dict(item.values)}
    more = {"by": item.by, "confidence": item.confidence, "note": item.note, "proposed": item.proposed or None}
    return {**json, **{key: value for key, value in more.items() if value is not None}}


# The rules of a layer, as in `Situ.Annotation.Layer`


def _default_values(schema: dict[str, Any], track: str) -> dict[str, Any]:
    tier = _find_tier(schema, track)
    attributes = [a for a in schema["attributes"] if tier is None or a["name"] == tier["attribute"]]
    return {a["name"]: _default_value(a) for a in attributes}


def _default_value(attribute: dict[str, Any]) -> Any:
    if attribute.get("default") is not None:
        return attribute["default"]
    return _choices(attribute)[0] if attribute["kind"] == "finite" else _EMPTY[attribute["kind"]]


def _choices(attribute: dict[str, Any]) -> list[str]:
    return [value if isinstance(value, str) else value["value"] for value in attribute["values"]]


def _check_rules(before: _State, after: _State, changed: list[int]) -> None:
    for id in changed:
        item = after.items.get(id)
        if item:
            _check_fields(item)
            _check_values(after.schema, item)
    tracks = {item.track for id in changed for item in [after.items.get(id)] if item}
    for track in tracks:
        _check_overlap([item for item in after.items.values() if item.track == track])
    for id in changed:
        _check_tier(before, after, id)


def _check_fields(item: Annotation) -> None:
    for time in (item.start, item.end):
        if isinstance(time, bool) or not -(1 << 63) <= operator.index(time) < 1 << 63:
            raise ValueError(f"time {time!r} is not a number of nanoseconds")
    if item.start > item.end:
        raise ValueError("the annotation ends before it begins")
    if not isinstance(item.track, str) or not item.track:
        raise ValueError("the annotation has no track")
    confidence: Any = item.confidence
    if confidence is not None and not (_is_number(confidence) and 0 <= confidence <= 1):
        raise ValueError(f"the confidence {confidence!r} is not between 0 and 1")
    if not isinstance(item.proposed, bool):
        raise ValueError("`proposed` is not a bool")
    for text in (item.track, item.by, item.note, *item.values):
        if text is not None:
            _check_text(text)


def _check_text(text: Any) -> None:
    if not isinstance(text, str):
        raise ValueError(f"{text!r} is not a str")
    text.encode()  # raises ValueError for half of a surrogate pair


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _check_values(schema: dict[str, Any], item: Annotation) -> None:
    attributes = {a["name"]: a for a in schema["attributes"]}
    for name, value in item.values.items():
        if name not in attributes:
            raise ValueError(f"the schema has no attribute {name!r}: use one of {', '.join(map(repr, attributes))}")
        kind = attributes[name]["kind"]
        if kind == "finite" and value not in _choices(attributes[name]):
            raise ValueError(f"{value!r} is not one of {', '.join(map(repr, _choices(attributes[name])))}")
        if kind == "text":
            _check_text(value)
        if kind == "number" and not _is_number(value) or kind == "bool" and not isinstance(value, bool):
            raise ValueError(f"{value!r} is not a value of the attribute {name!r}, which is a {kind}")


def _check_overlap(items: list[Annotation]) -> None:
    items.sort(key=lambda item: (item.start, item.end))
    for a, b in zip(items, items[1:]):
        if a.end == b.end or (a.start < b.end and b.start < a.end):
            raise ValueError(
                f"two annotations of track {a.track!r} would overlap: {a.start} to {a.end} and {b.start} to {b.end}"
            )


def _find_tier(schema: dict[str, Any], track: str) -> Optional[dict[str, Any]]:
    tiers: list[dict[str, Any]] = schema.get("tiers") or []
    found = next((tier for tier in tiers if tier["name"] == track), None)
    base, at, person = track.rpartition("@")
    if found or not (at and base and person):
        return found
    found = next((tier for tier in tiers if tier["name"] == base), None)
    parent = found and found.get("parent")
    return found and {**found, "name": track, "parent": f"{parent}@{person}" if parent else None}


def _check_tier(before: _State, after: _State, id: int) -> None:
    """Checks the rules of tiers. Edits that would also change parents or children are refused."""
    old, new = before.items.get(id), after.items.get(id)
    if old is None or new is None or any(getattr(old, f) != getattr(new, f) for f in _SPATIAL):
        for state, item in ((before, old), (after, new)):
            if item:
                _check_family(state, item)
    tier = _find_tier(after.schema, new.track) if new else None
    if new is None or tier is None:
        return
    if set(new.values) - {tier["attribute"]}:
        raise ValueError(f"track {new.track!r} has only the attribute {tier['attribute']!r}")
    parents = {other.get("parent") for other in after.schema["tiers"]}
    if new.start == new.end and (tier.get("parent") or {new.track, new.track.rpartition("@")[0]} & parents):
        raise ValueError("an annotation with a parent or children cannot be a point")
    if old != new and tier.get("parent"):
        _check_parent(after, new, tier)


def _check_family(state: _State, item: Annotation) -> None:
    for other in state.items.values():
        tier = _find_tier(state.schema, other.track)
        if tier and tier.get("parent") == item.track and other.start < item.end and other.end > item.start:
            raise ValueError(f"annotation {item.id} has others on the tiers below it: change it in the studio")
    tier = _find_tier(state.schema, item.track)
    if tier and tier.get("parent") and tier["relation"] != "included_in":
        raise ValueError(f"the times of track {item.track!r} depend on {tier['parent']!r}: change it in the studio")


def _check_parent(state: _State, item: Annotation, tier: dict[str, Any]) -> None:
    above = (a for a in state.items.values() if a.track == tier["parent"])
    if not any(a.start <= item.start and item.end <= a.end for a in above):
        raise ValueError(f"track {tier['parent']!r} has no annotation around this one: annotate it first")
