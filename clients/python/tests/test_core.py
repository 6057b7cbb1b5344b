"""Tests that the native core and the reader in Python read the same, also from damaged and truncated stores.

They need the extension module `situ_core`.
"""

import glob
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import unittest
import warnings

import situ
from situ import core, values
from situ.binary import Damaged

try:
    import numpy as np
except ImportError:
    np = None

GOLDEN = os.path.join(os.path.dirname(os.path.abspath(__file__)), "../../../test/golden")
PLAIN = [0, -1, 255, 1 << 40, -(1 << 63), (1 << 63) - 1, -(1 << 200), 1.5, -0.0, float("nan"), True, None, "ä"]
PLAIN += [b"\xff\x00", "", [1, [2]], (1, "x"), {"a": [None], "b": {}}, [], situ.Atom("hello")]
CODED = [
    situ.Image(2, 2, "gray8", 2, b"abcd"),
    situ.Tensor("<f4", (2, 1), b"01234567"),
    situ.AudioBuffer(16_000, 2, "s16", b"abcd"),
    situ.PointCloud(b"0123456789ab", b"rgb"),
]


def describe(value):
    """Returns a value in a form in which equal values are equal: NaN, views of bytes, integers and floats."""
    if isinstance(value, situ.Undecoded):
        return value.codec, value.data
    if type(value).__module__ == values.__name__:
        return type(value).__name__, b"".join(bytes(part) for part in values.encode_parts(value))
    return type(value).__name__, repr(value)


def write_all(store, numbers=3_000):
    for n in range(numbers):
        store.write("float", n * 1_000, n / 7)
        store.write("int", n * 1_001 - 5, (n * 7_919) ** 5 % (1 << 63) - n)
        store.write("truth", n, n % 3 == 0 if n % 500 else None, creation=n - 9)
        if n % 100 == 7:
            store.commit()
    for n, value in enumerate(PLAIN * 3):
        store.write("plain", n, value)
    for n, value in enumerate(CODED * 3):
        store.write("coded", n, value)
    for n in range(8):
        store.write("large", n, situ.Image(300, 200, "gray8", 300, bytes([n]) * 60_000))
        store.write("long", n, "x" * (20_000 * n))
    store.open("never", ":float")


def read_all(path, use, skip_damage):
    """Returns everything that can be read from a store, or the class of the exception."""
    try:
        store = situ.open(path, core=use)
    except (Damaged, FileNotFoundError) as error:
        return type(error)
    found = {"state": store.state, "created": store.created, "segment": store.segment}
    for name, stream in store.streams.items():
        # NaN differs from itself.
        found[name] = [(stream.type, stream.count, stream.first, stream.last, stream.closed, repr(stream.metadata))]
        try:
            for m in store.read(name, skip_damage=skip_damage):
                found[name].append((m.time, m.creation, m.sequence, describe(m.data)))
            middle = found[name][len(found[name]) // 2][0]
            if isinstance(middle, int):
                part = store.read(name, middle, middle + 10_000, skip_damage=skip_damage)
                found[name].append([(m.time, describe(m.data)) for m in part])
        except (Damaged, FileNotFoundError) as error:
            found[name].append(type(error))
        if np and stream.type in (":float", ":integer", ":boolean"):
            found[name].append(read_array(store, name, skip_damage))
    found["damaged"] = bool(store.damage)
    return found


VALUES = [
    lambda dice: dice.random(),
    lambda dice: dice.choice([0, 255, 256, -1, 1 << 31, -(1 << 63), (1 << 63) - 1]),
    lambda dice: dice.choice([True, False]),
    lambda dice: dice.choice(["a", "ä", "", "true"]),
    lambda dice: dice.choice([b"\xff", "text"]),
    lambda dice: situ.Atom(dice.choice(["on", "off"])),
    lambda dice: dice.choice([[1, 2], [3, 4], (1.5, "x"), []]),
    lambda dice: dice.choice([{"x": 1, "y": 2.5}, situ.Struct("P", {"x": 3, "z": {"a": "b"}})]),
    lambda dice: dice.choice([{}, situ.Struct("E", {}), {"x": {}}, {(1, 2): 3}, {5: 6}]),
    lambda dice: dice.choice([float("nan"), float("inf"), 1.0, 2]),
    lambda dice: dice.choice([1 << 63, 1 << 100, 5]),
    lambda dice: dice.choice([*PLAIN]),
]


def choose_field(dice):
    name = dice.choice(["x", "y", "long name", "ä", situ.Atom("x"), situ.Atom("nil"), "p", "p.x", situ.Atom("q")])
    # Values that are not obvious are rare, so that most streams are tables.
    return name, VALUES[dice.randrange(8) if dice.random() < 0.9 else dice.randrange(len(VALUES))]


def build_map(dice, fields):
    found = {name: None if dice.random() < 0.1 else choose(dice) for name, choose in fields}
    return situ.Struct("My.Map", {str(name): value for name, value in found.items()}) if len(found) % 2 else found


def describe_frame(store, name, start, stop):
    try:
        frame = store.frame(name, start, stop, skip_damage=True)
    except Exception as error:
        return type(error)
    columns = [(key, column.dtype, column.shape, [describe(item) for item in column]) for key, column in frame.items()]
    return columns, bool(store.damage)


def read_array(store, name, skip_damage):
    try:
        times, data = store.array(name, skip_damage=skip_damage)
        part = store.array(name, 10_000, 1_500_000, skip_damage=skip_damage)
    except Exception as error:
        # Values of several types may have no array.
        return type(error)
    # The text, because NaN differs from itself.
    return [(array.dtype.kind if len(array) else "", repr(array.tolist())) for array in (times, data, *part)]


@unittest.skipUnless(core.is_installed(), "situ_core is not installed")
class SameTest(unittest.TestCase):
    maxDiff = 2_000

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.root = folder.name

    def assert_same(self, path):
        for skip_damage in (True, False):
            found = [read_all(path, use, skip_damage) for use in (True, False)]
            if not isinstance(found[0], dict) or not isinstance(found[1], dict):
                self.assertEqual(found[0], found[1])
                continue
            self.assertEqual(list(found[0]), list(found[1]))
            for name, value in found[0].items():
                self.assertEqual(value, found[1][name], f"{name}, skip_damage={skip_damage}")

    def test_golden_recordings(self):
        paths = glob.glob(os.path.join(GOLDEN, "*/recordings/*.[0-9][0-9][0-9][0-9]"))
        self.assertGreater(len(paths), 3)
        for path in paths:
            with self.subTest(path):
                self.assert_same(path)

    def test_both_writers_write_the_same(self):
        for use in (True, False):
            with situ.create("all", self.root, core=use) as store:
                write_all(store)
            self.assert_same(os.path.join(self.root, "all"))
        found = [read_all(os.path.join(self.root, f"all.000{n}"), True, False) for n in (0, 1)]
        for name, messages in found[0].items():
            if isinstance(messages, list):
                # The creation times are those of the clock.
                rows = [[(row[0], *row[2:]) if len(row) == 4 else row for row in run[name][:-1]] for run in found]
                self.assertEqual(*rows, name)

    def test_damaged_and_truncated_stores(self):
        dice = random.Random(8)
        for use in (True, False):
            with situ.create("all", self.root, core=use) as store:
                write_all(store, 350)
            original = store.path
            for n in range(50):
                path = f"{self.root}/copy.0000"
                shutil.copytree(original, path)
                name = dice.choice(["index.situ", "data-000000.situ", "data-000000.situ", "large-000000.situ"])
                self.damage_file(os.path.join(path, name), dice)
                with self.subTest(f"{n}, {name}, core={use}"):
                    self.assert_same(path)
                shutil.rmtree(path)

    def damage_file(self, path, dice):
        size = os.path.getsize(path)
        if dice.random() < 0.1:
            return os.remove(path)
        if dice.random() < 0.3:
            return os.truncate(path, dice.randrange(size))
        with open(path, "r+b") as file:
            for _ in range(dice.randint(1, 3)):
                file.seek(dice.randrange(min(size, 6_000) if dice.random() < 0.5 else size))
                file.write(bytes([dice.randrange(256)]))

    @unittest.skipUnless(np, "numpy is not installed")
    def test_frames(self):
        paths = glob.glob(os.path.join(GOLDEN, "*/recordings/*.[0-9][0-9][0-9][0-9]"))
        for path in paths:
            self.assert_same_frames(path, path)
        dice = random.Random(3)
        with situ.create("maps", self.root) as store:
            for number in range(300):
                fields = [choose_field(dice) for _ in range(dice.randint(0, 4))]
                for time in range(dice.randint(1, 9)):
                    chosen = [field for field in fields if dice.random() < 0.9 or number % 2]
                    store.write(f"{number}", time, build_map(dice, chosen))
                if number % 50 == 0:
                    store.write(f"{number}", 10, dice.choice(PLAIN))
        self.assert_same_frames(f"{self.root}/maps", "random maps")

    def assert_same_frames(self, path, label):
        stores = [situ.open(path, core=use) for use in (True, False)]
        for name in stores[0].streams:
            for start, stop in ((None, None), (2, 5)):
                found = [describe_frame(store, name, start, stop) for store in stores]
                self.assertEqual(*found, f"{label}, {name}")

    @unittest.skipUnless(np, "numpy is not installed")
    def test_frames_of_segments(self):
        for number in range(4):
            with situ.create("hall", self.root) as store:
                store._add_record({"kind": "piece", "every": 10, "run": "b" if number == 3 else "a"})
                for time in range(10 * number, 10 * number + 10 - number):
                    # The last run hides the end of the first one.
                    store.write("same", time - 25 * (number == 3), {"x": time, "on": None if number % 2 else True})
                    store.write("changed", time, {"x": time} if number % 2 else {"x": "text", "y": 1.5})
        self.assert_same_frames(f"{self.root}/hall", "segments")
        self.assertEqual(situ.open(f"{self.root}/hall").frame("same").rows, 5 + 7)

    @unittest.skipUnless(np, "numpy is not installed")
    def test_frames_of_maps_are_read_by_the_core(self):
        point = situ.Struct("Situ.Point2", {"x": 1.5, "y": 2})
        rows = [{"point": point, "state": situ.Atom("ok"), "on": None, "list": [1, 2]}] * 3
        with situ.create("a", self.root) as store:
            for time, row in enumerate([*rows, {**rows[0], "on": True, "new": 1 << 40}]):
                store.write("s", time, row)
        store = situ.open(f"{self.root}/a")
        store._read_range = None
        frame = store.frame("s")
        self.assertEqual(list(frame), ["time", "point.x", "point.y", "state", "on", "list", "new"])
        self.assertEqual(frame["on"].tolist(), [None, None, None, True])
        self.assertIsInstance(frame["state"][0], situ.Atom)
        self.assertIsNot(frame["list"][0], frame["list"][1])
        self.assertEqual(frame["new"].tolist()[3], float(1 << 40))

    @unittest.skipUnless(np, "numpy is not installed")
    def test_numbers_and_images_are_not_copied(self):
        with situ.create("a", self.root) as store:
            write_all(store)
        store = situ.open(f"{self.root}/a")
        times, data = store.array("float")
        self.assertFalse(times.flags.owndata or data.flags.owndata)
        self.assertTrue(data.flags.writeable)
        image = next(store.read("large")).data
        self.assertIsInstance(image.data, memoryview)
        self.assertFalse(image.array.flags.writeable)
        del store
        self.assertEqual(int(image.array.sum() + times[-1] + data[0]), 2_999_000)


@unittest.skipUnless(core.is_installed(), "situ_core is not installed")
class CoreWriterTest(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.root = folder.name

    def test_a_store_can_be_read_while_it_is_written(self):
        writer = situ.create("a", self.root)
        store = situ.open(f"{self.root}/a")
        for n in range(10):
            writer.write("n", n, n)
            writer.commit()
            store.refresh()
            self.assertEqual([m.data for m in store.read("n")], list(range(n + 1)))
        self.assertEqual(store.state, "live")
        writer.close()
        store.refresh()
        self.assertEqual(store.state, "closed")
        writer.close()

    def test_a_kill_loses_nothing_that_was_committed(self):
        program = """if True:
            import situ, sys
            writer = situ.create("a", sys.argv[1], core=True)
            for n in range(10**9):
                writer.write("n", n, n)
                writer.write("text", n, str(n))
                if n % 100 == 99:
                    writer.commit()
                    print(n, flush=True)
        """
        with subprocess.Popen([sys.executable, "-c", program, self.root], stdout=subprocess.PIPE) as writer:
            last = 0
            for _ in range(200):
                last = int(writer.stdout.readline())
            writer.send_signal(signal.SIGKILL)
        store = situ.open(f"{self.root}/a")
        self.assertEqual(store.state, "abandoned")
        for name, convert in (("n", int), ("text", str)):
            found = [m.data for m in store.read(name)]
            self.assertEqual(found, [convert(n) for n in range(len(found))])
            self.assertGreater(len(found), last)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            self.assertGreater(sum(1 for _ in store.read("n", follow=True)), last)
        self.assertEqual([w.category for w in caught], [situ.AbandonedWarning])

    def test_refuses_what_the_format_cannot_represent(self):
        for use in (True, False):
            with situ.create("a", self.root, core=use) as writer:
                writer.write("n", 5, 1)
                for time in (5, 4):
                    with self.assertRaisesRegex(ValueError, "stream 'n'"):
                        writer.write("n", time, 1)
                with self.assertRaises(ValueError):
                    writer.write("n", 1 << 63, 1)
                with self.assertRaises(TypeError):
                    writer.write("n", "6", 1)
                with self.assertRaises(TypeError):
                    writer.write("n", 6, object())
                with self.assertRaises(ValueError):
                    writer.open("n", ":float")
                writer.write("n", 7, 1 << 70)
            for name in ("n", "other"):
                with self.assertRaisesRegex(ValueError, "closed"):
                    writer.write(name, 9, 1)
            self.assertEqual([m.data for m in situ.open(writer.path).read("n")], [1, 1 << 70])

    @unittest.skipUnless(np, "numpy is not installed")
    def test_writes_arrays(self):
        times = np.arange(3_000) * 1_000
        columns = {
            "f4": np.linspace(0, 1, 3_000, dtype="f4"),
            "f8": np.linspace(0, 1, 3_000),
            "i2": np.arange(3_000, dtype="i2"),
            "u8": np.arange(3_000, dtype="u8") + (1 << 63),
            "bool": times % 7 == 0,
            "nan": np.where(times % 7 == 0, np.nan, 1.5),
            "rows": np.arange(9_000.0).reshape(3_000, 3),
        }
        for use in (True, False):
            with situ.create("a", self.root, core=use) as writer:
                for name, column in columns.items():
                    writer.write_array(name, times, column)
                writer.write_array("later", times.astype("M8[ns]"), columns["f8"], times + 5)
                with self.assertRaises(ValueError):
                    writer.write_array("f8", times[:5] + 10**9, columns["f8"])
                with self.assertRaisesRegex(ValueError, "'f8'"):
                    writer.write_array("f8", times, columns["f8"])
            store = situ.open(writer.path)
            for name, column in columns.items():
                found = store.array(name)
                self.assertTrue((found[0] == times).all())
                np.testing.assert_array_equal(found[1].astype(column.dtype), column, name)
            self.assertEqual({m.creation - m.time for m in store.read("later")}, {5})


if __name__ == "__main__":
    unittest.main()
