"""Tests frames: streams as columns. They need numpy; pandas, pyarrow and polars are tested if they are installed."""

import contextlib
import datetime
import importlib.util
import io
import tempfile
import unittest

import situ
from situ import core, frames, progress

try:
    import numpy as np
except ImportError:
    np = None

SECOND = 1_000_000_000


@unittest.skipUnless(np, "numpy is not installed")
class FramesTest(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        with situ.create("walk", folder.name) as store:
            for i in range(100):
                store.write("Level", i * SECOND, i / 2)
                store.write("Pose", i * SECOND + SECOND // 10, {"x": i, "angle": {"yaw": i * 0.5}, "name": f"p{i}"})
            for i in range(0, 100, 10):
                store.write("Spectrum", i * SECOND, np.full(4, i, "f4"))
                store.write("Mode", i * SECOND + 1, f"mode {i}")
                store.write("Partial", i * SECOND, {"a": 1} if i else {"a": None, "b": [1]})
        self.store = situ.open(f"{folder.name}/walk")

    def test_numbers_are_one_column(self):
        frame = self.store.frame("Level", start=10 * SECOND, end="1970-01-01T00:00:19.5Z")
        self.assertEqual(list(frame), ["time", "value"])
        self.assertEqual((frame.rows, frame["value"].dtype), (10, np.float64))
        self.assertEqual(frame["time"][0], np.datetime64("1970-01-01T00:00:10"))
        moment = datetime.datetime(1970, 1, 1, 0, 1, 39, tzinfo=datetime.timezone.utc)
        self.assertEqual(self.store.frame("Level", start=moment).rows, 1)
        with self.assertRaisesRegex(KeyError, "unknown column 'x'"):
            frame["x"]
        with self.assertRaises(KeyError):
            self.store.frame("Levels")
        self.assertEqual(self.store.frame("Level", start=1_000 * SECOND).rows, 0)

    def test_fields_of_maps_are_columns(self):
        frame = self.store.frame("Pose")
        self.assertEqual(sorted(frame), ["angle.yaw", "name", "time", "x"])
        self.assertEqual((frame["x"].dtype, frame["angle.yaw"].dtype), (np.int64, np.float64))
        self.assertEqual(frame["name"][3], "p3")
        partial = self.store.frame("Partial")
        self.assertTrue(np.isnan(partial["a"][0]) and partial["a"][1] == 1)
        self.assertEqual([partial["b"][0], partial["b"][1]], [[1], None])
        self.assertEqual(self.store.frame("Spectrum")["value"].shape, (10, 4))

    def test_joins_the_nearest_or_the_last_values(self):
        joined = self.store.join(["Level", "Pose", "Mode"], tolerance=2 * SECOND)
        self.assertEqual(list(joined)[:2], ["time", "Level"])
        self.assertEqual(joined.rows, 100)
        self.assertTrue((joined["Pose.x"] == np.arange(100)).all())
        self.assertEqual([joined["Mode"][i] for i in (0, 2, 3, 9)], ["mode 0", "mode 0", None, "mode 10"])

        last = self.store.join(["Pose", "Level"], on="Level", how="last")
        self.assertTrue(np.isnan(last["Pose.x"][0]))
        self.assertTrue((last["Pose.x"][1:] == np.arange(99)).all())
        self.assertIsNone(last["Pose.name"][0])
        on_mode = self.store.join(["Level", "Spectrum"], on="Mode")
        self.assertEqual(list(on_mode), ["time", "Level", "Spectrum"])
        self.assertEqual(on_mode["Spectrum"].shape, (10, 4))
        part = self.store.join(["Level", "Spectrum"], start=11 * SECOND, end=12 * SECOND)
        self.assertEqual((part.rows, part["Spectrum"].tolist()), (2, [[10.0] * 4] * 2))
        part = self.store.join(["Level", "Mode"], start=11 * SECOND, end=12 * SECOND, tolerance=SECOND // 2)
        self.assertEqual(part["Mode"].tolist(), [None, None])
        exact = self.store.join(["Mode", "Level", "Partial"], on="Level", how="exact")
        self.assertEqual((exact["Partial.a"][10], set(exact["Mode"])), (1, {None}))
        with self.assertRaisesRegex(ValueError, "nearest"):
            self.store.join(["Level"], how="next")

    def test_matching_agrees_with_a_search_of_all_rows(self):
        random = np.random.default_rng(5)
        for _ in range(200):
            given = np.unique(random.integers(0, 60, random.integers(1, 20)))
            wanted = np.sort(random.integers(0, 60, 15))
            tolerance = int(random.integers(0, 8))
            rows, found = frames._match_rows(np, given, wanted, "nearest", tolerance)
            for row, is_found, time in zip(rows, found, wanted):
                distance = np.abs(given - time)
                self.assertEqual(is_found, distance.min() <= tolerance)
                # The later one of two at the same distance, as in Situ.
                self.assertEqual(row, np.flatnonzero(distance == distance.min())[-1])

    def test_notebooks_show_a_picture_and_a_table(self):
        page = self.store._repr_html_()
        self.assertEqual(page.count("<rect"), 5)
        self.assertIn("100 messages", page)
        self.assertIn("<th>Level</th>", self.store.join(["Level"])._repr_html_())
        expected = "<situ.Frame of 100 rows; time: datetime64[ns], value: float64>"
        self.assertEqual(repr(self.store.frame("Level")), expected)

    def test_large_messages_are_read_when_they_are_used(self):
        for use in [False] + [True] * core.is_installed():
            with tempfile.TemporaryDirectory() as root:
                with situ.create("a", root, core=use) as store:
                    for n in range(5):
                        store.write("Camera", n, situ.Image.from_array(np.full((200, 300), n, "u1")))
                        store.write("Big", n, np.full(9_000, n, "f4"))
                        store.write("Small", n, situ.Image.from_array(np.full((2, 3), n, "u1")))
                store = situ.open(f"{root}/a", core=use)
                frame = store.frame("Camera", start=1)
                self.assertIsInstance(frame["value"][0], situ.Lazy)
                sums = [int(image.array.sum()) for image in frame["value"]]
                self.assertEqual(sums, [60_000 * n for n in range(1, 5)])
                self.assertEqual(frame["value"][3].load().width, 300)
                self.assertEqual(store.frame("Big")["value"].shape, (5, 9_000))
                self.assertEqual(store.frame("Small")["value"].shape, (5, 2, 3))
                self.assertEqual(store.join(["Small", "Camera"])["Camera"][2].time, 2)
                with open(f"{root}/a.0000/large-000000.situ", "r+b") as file:
                    file.seek(5_000)
                    file.write(b"damage")
                self.assertEqual(len(situ.open(f"{root}/a", core=use).frame("Camera")["value"]), 5)
                with self.assertRaises(situ.Damaged):
                    situ.open(f"{root}/a", core=use).frame("Camera")["value"][0].load()

    def test_progress_is_shown_on_request(self):
        with contextlib.redirect_stderr(io.StringIO()) as shown:
            self.store.frame("Level")
            with progress.Progress("Reading Level", True) as report:
                report._next = 0
                report(0.425)
        self.assertEqual(shown.getvalue().split("\r")[1:2], ["Reading Level: 42 %"])
        self.assertEqual(shown.getvalue().split("\r")[-2].strip(), "")

    @unittest.skipUnless(importlib.util.find_spec("pandas"), "pandas is not installed")
    def test_pandas(self):
        frame = self.store.join(["Level", "Pose"]).to_pandas()
        self.assertEqual(frame.loc["1970-01-01T00:00:03+00:00", "Pose.x"], 3)

    @unittest.skipUnless(importlib.util.find_spec("pyarrow"), "pyarrow is not installed")
    def test_arrow(self):
        table = self.store.frame("Spectrum").to_arrow()
        self.assertEqual(str(table.schema.field("time").type), "timestamp[ns, tz=UTC]")
        self.assertEqual(table["value"][2].as_py(), [20.0] * 4)

    @unittest.skipUnless(importlib.util.find_spec("polars"), "polars is not installed")
    def test_polars(self):
        self.assertEqual(self.store.frame("Level").to_polars()["value"].sum(), sum(range(100)) / 2)
        with situ.create("poses", self.store.path) as store:
            store.write("Head", 1, situ.Pose((1, 2, 3), (1, 0, 0, 0)))
        poses = situ.open(store.path).frame("Head").to_polars()
        self.assertEqual(poses["value"][0].position, (1, 2, 3))


VALUES = {
    "float": [0.5, -1.0, float("inf")],
    "truth": [True, False, True],
    "text": ["a", "ä" * 50, ""],
    "bytes": [b"", b"\xff", b"abc"],
    "list": [[1, 2], [], [3]],
    "nested": [[[1.5], []], [], [[2.5, 3.5]]],
    "map": [{"a": 1, "b": {"c": "x"}}, {"a": 2, "b": {"c": "y"}}, {"a": 3, "b": {"c": "z"}}],
    "partial": [None, "x", None],
    "maybe": [True, None, False],
    "none": [None, None, None],
}


@unittest.skipUnless(np and core.is_installed(), "numpy or situ_core is not installed")
class ArrowTest(unittest.TestCase):
    def setUp(self):
        self.time = np.array([5, 6, 7], "M8[ns]")
        objects = {}
        for name, items in VALUES.items():
            objects[name] = np.empty(3, object)
            objects[name][:] = items
        kinds = ["i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f4", "f8"]
        numbers = {kind: np.arange(9, dtype=kind)[::3] for kind in kinds}
        rows = {"rows": np.arange(12, dtype="f4").reshape(3, 2, 2)}
        self.frame = situ.Frame({"time": self.time, **objects, **numbers, **rows})

    @unittest.skipUnless(importlib.util.find_spec("pyarrow"), "pyarrow is not installed")
    def test_pyarrow_takes_every_column(self):
        import pyarrow

        table = pyarrow.table(self.frame)
        table.validate(full=True)
        for name, items in VALUES.items():
            self.assertEqual(table[name].to_pylist(), items, name)
        for kind in ("i1", "u8", "f4"):
            self.assertEqual(table[kind].to_pylist(), [0, 3, 6], kind)
        self.assertEqual(table["rows"].to_pylist()[2], [8.0, 9.0, 10.0, 11.0])
        self.assertEqual(table["time"].cast("int64").to_pylist(), [5, 6, 7])
        address = table["rows"].chunk(0).flatten().buffers()[1].address
        self.assertEqual(address, self.frame["rows"].__array_interface__["data"][0])
        # The memory outlives the frame, and a capsule that nobody takes is released.
        column = table["rows"]
        self.frame.__arrow_c_stream__()
        del table, self.frame
        self.assertEqual(column.to_pylist()[2], [8.0, 9.0, 10.0, 11.0])

    @unittest.skipUnless(importlib.util.find_spec("polars"), "polars is not installed")
    def test_polars_takes_every_column(self):
        import polars

        table = polars.DataFrame(self.frame)
        for name, items in VALUES.items():
            self.assertEqual(table[name].to_list(), items, name)
        self.assertEqual(table["rows"].to_list()[2], [8.0, 9.0, 10.0, 11.0])
        self.assertEqual(table["time"].dtype.time_zone, "UTC")
        floats = situ.Frame({"time": self.time, "f8": np.arange(3.0)})
        column = polars.DataFrame(floats)["f8"].to_numpy()
        self.assertEqual(column.__array_interface__["data"], (floats["f8"].__array_interface__["data"][0], True))

    @unittest.skipUnless(importlib.util.find_spec("duckdb"), "duckdb is not installed")
    def test_duckdb_queries_a_frame(self):
        import duckdb

        frame = self.frame
        rows = duckdb.sql('select count(*), sum("i4"), max("text") from frame').fetchall()
        self.assertEqual(rows, [(3, 9, "ä" * 50)])
        rows = duckdb.sql("select epoch_ns(time), list, map.b.c from frame where truth").fetchall()
        self.assertEqual(rows, [(5, [1, 2], "x"), (7, [3], "z")])
        del frame

    def test_says_which_column_it_cannot_represent(self):
        column = np.empty(2, object)
        column[:] = [situ.Pose((1, 2, 3), (1, 0, 0, 0)), 5]
        frame = situ.Frame({"time": self.time[:2], "a": self.time[:2], "Pose": column})
        with self.assertRaisesRegex(TypeError, "'Pose'.*frame.select"):
            frame.__arrow_c_stream__()
        frame.select(["time", "a"]).__arrow_c_stream__()


if __name__ == "__main__":
    unittest.main()
