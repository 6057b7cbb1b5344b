"""Converts times, which are integer nanoseconds since 1970, UTC, to and from other representations."""

import datetime
import re
import time

# The time from 0001-01-01 to 1970-01-01 in ticks of 100 ns, the unit of times in MessagePack messages.
EPOCH_TICKS = 621_355_968_000_000_000
_EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.timezone.utc)
_TEXT = re.compile(r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)(?:\.(\d{1,9}))?(Z|[+-]\d\d:\d\d)?\Z")


def now() -> int:
    """Returns the wall clock time."""
    return time.time_ns()


def from_datetime(moment: datetime.datetime) -> int:
    """Converts a datetime. A datetime without a time zone is in UTC."""
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=datetime.timezone.utc)
    delta = moment - _EPOCH
    return ((delta.days * 86_400 + delta.seconds) * 1_000_000 + delta.microseconds) * 1_000


def to_datetime(ns: int) -> datetime.datetime:
    """Converts a time to a datetime in UTC, which has microsecond resolution."""
    return _EPOCH + datetime.timedelta(microseconds=ns // 1_000)


def to_text(ns: int) -> str:
    """Formats a time as ISO 8601 with nanoseconds.

    >>> to_text(1_500_000_000_123_456_789)
    '2017-07-14T02:40:00.123456789Z'
    """
    seconds, rest = divmod(ns, 1_000_000_000)
    return f"{(_EPOCH + datetime.timedelta(seconds=seconds)):%Y-%m-%dT%H:%M:%S}.{rest:09}Z"


def from_text(text: str) -> int:
    """Parses an ISO 8601 time. Without a time zone, it is in UTC.

    >>> from_text("2017-07-14T02:40:00.5Z")
    1500000000500000000
    """
    match = _TEXT.match(text)
    if not match:
        raise ValueError(f"{text!r} is not a time like 2020-01-31T12:34:56.1234567Z")
    seconds, fraction, zone = match.groups()
    moment = datetime.datetime.fromisoformat(seconds + ("+00:00" if zone in (None, "Z") else zone))
    return from_datetime(moment) + int((fraction or "0").ljust(9, "0"))


def from_ticks(ticks: int) -> int:
    """Converts ticks of 100 ns since 0001-01-01."""
    return (ticks - EPOCH_TICKS) * 100


def to_ticks(ns: int) -> int:
    """Converts a time to ticks of 100 ns since 0001-01-01."""
    return ns // 100 + EPOCH_TICKS
