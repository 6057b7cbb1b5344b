"""Streams as tables of columns: `store.frame("IMU")` and `store.join(["IMU", "Pose"], on="IMU")`."""

from __future__ import annotations

import datetime
import html
from collections.abc import ItemsView, Iterator, KeysView, Mapping, Sequence, ValuesView
from typing import Any, Optional, Union

from . import arrow, core, times
from .lazy import Lazy
from .progress import Progress
from .values import import_numpy

Moment = Union[int, str, datetime.datetime, None]
_NUMBERS = (":integer", ":float", ":boolean", ":number")
_SHOWN_ROWS = 10
_LAZY_TYPES = ("Situ.Image", "Situ.DepthImage", "Situ.EncodedImage", "Situ.PointCloud")


# Not a subclass of Mapping, because polars would then take it as a dict and not as a table.
class Frame:
    """A table: a numpy array for each column. `time` contains the originating times as datetime64[ns], UTC.

    It has the methods of a mapping from names to arrays of shape (rows,) or (rows, *shape). pyarrow, polars, pandas and
    DuckDB take it as it is, without a copy of the numbers, if the native core is installed: `polars.DataFrame(frame)`,
    `pyarrow.table(frame)`, `duckdb.sql("select * from frame")`. `to_pandas`, `to_arrow` and `to_polars` need these
    packages, but not the core.
    """

    def __init__(self, columns: dict[str, Any]) -> None:
        self.columns = columns

    def __getitem__(self, name: str) -> Any:
        if name not in self.columns:
            raise KeyError(f"unknown column {name!r}; the columns are {list(self.columns)}")
        return self.columns[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns)

    def __len__(self) -> int:
        """Returns the number of columns, as of every mapping. `rows` is the number of rows."""
        return len(self.columns)

    def __contains__(self, name: object) -> bool:
        return name in self.columns

    def keys(self) -> KeysView[str]:
        """Returns the names of the columns."""
        return self.columns.keys()

    def values(self) -> ValuesView[Any]:
        """Returns the columns."""
        return self.columns.values()

    def items(self) -> ItemsView[str, Any]:
        """Returns the names and the columns."""
        return self.columns.items()

    @property
    def rows(self) -> int:
        """The number of rows."""
        return len(self.columns["time"])

    def select(self, names: Sequence[str]) -> Frame:
        """Returns a frame of these columns, without a copy."""
        return Frame({name: self[name] for name in names})

    def __arrow_c_stream__(self, requested_schema: object = None) -> Any:
        """Exports the table through Arrow's C stream interface. The schema cannot be changed.

        Rows of several dimensions are lists of a fixed size. Raises TypeError for a column of values such as images.
        """
        return arrow.export_columns(self.columns)

    def to_pandas(self) -> Any:
        """Returns a pandas.DataFrame whose index is the time."""
        import pandas  # type: ignore[import-untyped, unused-ignore]

        data = {name: _flatten(column) for name, column in self.columns.items() if name != "time"}
        index = pandas.DatetimeIndex(self.columns["time"], tz="UTC", name="time", copy=False)
        return pandas.DataFrame(data, index=index, copy=False)

    def to_arrow(self) -> Any:
        """Returns a pyarrow.Table. Numbers without missing values are not copied."""
        import pyarrow  # type: ignore[import-untyped, unused-ignore]

        if core.is_installed():
            return pyarrow.table(self)
        columns = {name: pyarrow.array(_flatten(column)) for name, column in self.columns.items()}
        columns["time"] = columns["time"].cast(pyarrow.timestamp("ns", "UTC"))
        return pyarrow.table(columns)

    def to_polars(self) -> Any:
        """Returns a polars.DataFrame. Needs no pyarrow."""
        import polars

        if core.is_installed():
            try:
                return polars.DataFrame(self)
            except TypeError:
                # Columns of polars can contain any object, unlike those of Arrow.
                pass
        frame = polars.DataFrame({name: _flatten(column) for name, column in self.columns.items()})
        return frame.with_columns(polars.col("time").dt.replace_time_zone("UTC"))

    def __repr__(self) -> str:
        kinds = ", ".join(f"{name}: {column.dtype}" for name, column in self.columns.items())
        return f"<situ.Frame of {self.rows} rows; {kinds}>"

    def _repr_html_(self) -> str:
        head = "".join(f"<th>{html.escape(name)}</th>" for name in self.columns)
        rows = (
            "".join(f"<td>{html.escape(str(column[row]))}</td>" for column in self.columns.values())
            for row in range(min(self.rows, _SHOWN_ROWS))
        )
        body = "".join(f"<tr>{row}</tr>" for row in rows)
        return f"<table><tr>{head}</tr>{body}</table><p>{self.rows} rows</p>"


def _flatten(column: Any) -> Any:
    """Returns a column of one dimension: the rows of others become lists."""
    return column if column.ndim == 1 else list(column)


class FrameReader:
    """The methods of stores that return frames. They need numpy."""

    def frame(
        self,
        name: str,
        start: Moment = None,
        end: Moment = None,
        skip_damage: bool = False,
        progress: Optional[bool] = None,
    ) -> Frame:
        """Returns a stream as a `Frame` from `start` to `end`, inclusive: integers (ns), datetimes or ISO 8601 texts.

        Numbers and arrays of one shape are the column `value`. The fields of maps and structs are columns, also those
        of maps inside of maps, as in `position.x`. Other values are objects. Images and point clouds of 32 KiB or more
        are `Lazy`: they are read when they are used. A missing number is NaN. `progress` is that of `array`.
        """
        np = import_numpy()
        first, last = _to_ns(start), _to_ns(end)
        store: Any = self
        if name in store.streams and store.streams[name].type in _NUMBERS:
            moments, data = store.array(name, first, last, skip_damage, progress)
            return Frame({"time": moments.view("M8[ns]"), "value": data})
        count = store.streams[name].count if name in store.streams else 1
        messages = []
        with Progress(f"Reading {name}", progress) as report:
            table = store._read_table(name, first, last, skip_damage, report)
            if table is not None:
                return Frame(table)
            for message in store._read_range(name, first, last, skip_damage):
                messages.append(message)
                report(min(len(messages) / max(count, 1), 1))
        moments = np.array([message.time for message in messages], "i8").view("M8[ns]")
        return Frame({"time": moments, **_build_columns([_resolve(message.data) for message in messages])})

    def join(
        self,
        names: Sequence[str],
        on: Optional[str] = None,
        tolerance: Optional[int] = None,
        how: str = "nearest",
        start: Moment = None,
        end: Moment = None,
        skip_damage: bool = False,
        progress: Optional[bool] = None,
    ) -> Frame:
        """Returns the streams `names` as one `Frame` with the times of the stream `on`, by default the first one.

        Each row has the values of the other streams whose time is nearest (`how="nearest"`; of two at the same
        distance, the later one), the last ones up to this time (`how="last"`), or those at exactly this time
        (`how="exact"`), but not those that are more than `tolerance` (ns) away. `Situ.join` selects the same ones.
        Where there are none, numbers are NaN and other values None. The columns are named `STREAM`, or `STREAM.FIELD`
        for maps. `skip_damage` and `progress` are those of `frame`.
        """
        np = import_numpy()
        if how not in ("nearest", "last", "exact"):
            raise ValueError(f"how must be 'nearest', 'last' or 'exact', not {how!r}")
        if how == "exact":
            how, tolerance = "last", 0
        on = names[0] if on is None else on
        first, last = _to_ns(start), _to_ns(end)
        frames = {on: self.frame(on, first, last, skip_damage, progress)}
        # Values outside of the interval may be the nearest ones.
        low = None if first is None or tolerance is None else first - tolerance
        high = None if last is None or tolerance is None else last + tolerance
        for name in names:
            if name not in frames:
                frames[name] = self.frame(name, low, high, skip_damage, progress)
        moments = frames[on]["time"]
        joined: dict[str, Any] = {"time": moments}
        for name in names:
            frame = frames[name]
            rows, found = _match_rows(np, frame["time"].view("i8"), moments.view("i8"), how, tolerance)
            for key, column in frame.items():
                if key != "time":
                    label = name if key == "value" else f"{name}.{key}"
                    joined[label] = _take_rows(np, column, rows, found)
        return Frame(joined)

    def _repr_html_(self) -> str:
        """Draws the streams as bars over time, for notebooks."""
        store: Any = self
        streams = [stream for stream in store.streams.values() if stream.first is not None]
        title = f"<p>{html.escape(repr(store)[1:-1])}</p>"
        if not streams:
            return title
        low, high = min(stream.first for stream in streams), max(stream.last for stream in streams)
        scale = 600 / max(high - low, 1)
        bars = [
            f'<text x="0" y="{18 * row + 13}">{html.escape(stream.name[:28])}</text>'
            f'<rect x="{200 + (stream.first - low) * scale:.1f}" y="{18 * row + 2}" height="14" fill="#4c78a8" '
            f'width="{max((stream.last - stream.first) * scale, 1):.1f}"><title>{stream.count} messages</title></rect>'
            for row, stream in enumerate(streams)
        ]
        caption = f"<p>{times.to_text(low)} to {times.to_text(high)}</p>"
        size = f'width="820" height="{18 * len(streams)}" font-size="12" font-family="sans-serif"'
        return f'{title}<svg xmlns="http://www.w3.org/2000/svg" {size}>{"".join(bars)}</svg>{caption}'


def _to_ns(moment: Moment) -> Optional[int]:
    if isinstance(moment, str):
        return times.from_text(moment)
    if isinstance(moment, datetime.datetime):
        return times.from_datetime(moment)
    return None if moment is None else int(moment)


def _resolve(data: Any) -> Any:
    """Returns the value of a large message, unless it is of a kind that is not put together to arrays."""
    if not isinstance(data, Lazy) or data.type_name in _LAZY_TYPES:
        return data
    return data.load()


def _build_columns(data: list[Any]) -> dict[str, Any]:
    rows = [_flatten_map(value, "") if isinstance(value, dict) else {"value": value} for value in data]
    names = dict.fromkeys(name for row in rows for name in row) or {"value": None}
    return {name: _build_column([row.get(name) for row in rows]) for name in names}


def _flatten_map(value: Mapping[Any, Any], prefix: str) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, item in value.items():
        if isinstance(item, dict) and item:
            flat.update(_flatten_map(item, f"{prefix}{key}."))
        else:
            flat[f"{prefix}{key}"] = item
    return flat


def _build_column(items: list[Any]) -> Any:
    np = import_numpy()
    kinds = {type(item) for item in items}
    if kinds == {bool} or kinds == {int}:
        try:
            return np.array(items, "?" if kinds == {bool} else "i8")
        except OverflowError:
            pass
    elif kinds and kinds <= {int, float, type(None)}:
        return np.array([np.nan if item is None else item for item in items], "f8")
    if Lazy in kinds:
        return _build_objects(np, items)
    arrays = [item.array if hasattr(item, "array") else item for item in items]
    if arrays and all(isinstance(array, np.ndarray) for array in arrays) and len({a.shape for a in arrays}) == 1:
        return np.stack(arrays)
    return _build_objects(np, items)


def _build_objects(np: Any, items: list[Any]) -> Any:
    column = np.empty(len(items), object)
    # Numpy would take a list of lists as an array of two dimensions.
    for row, item in enumerate(items):
        column[row] = item
    return column


def _match_rows(np: Any, given: Any, wanted: Any, how: str, tolerance: Optional[int]) -> tuple[Any, Any]:
    """Returns the row of `given` for each time in `wanted`, and whether there is one."""
    if len(given) == 0:
        return np.zeros(len(wanted), "i8"), np.zeros(len(wanted), "?")
    before = np.searchsorted(given, wanted, "right") - 1
    rows = np.maximum(before, 0)
    if how == "nearest":
        after = np.minimum(before + 1, len(given) - 1)
        rows = np.where(np.abs(given[after] - wanted) <= np.abs(given[rows] - wanted), after, rows)
        found = np.ones(len(wanted), "?")
    else:
        found = before >= 0
    if tolerance is not None:
        found &= np.abs(given[rows] - wanted) <= tolerance
    return rows, found


def _take_rows(np: Any, column: Any, rows: Any, found: Any) -> Any:
    if found.all():
        return column[rows]
    if column.dtype == object or column.dtype == bool:
        taken = np.full((len(rows), *column.shape[1:]), None, object)
    else:
        taken = np.full((len(rows), *column.shape[1:]), np.nan, "f4" if column.dtype == np.float32 else "f8")
    taken[found] = column[rows[found]]
    return taken
