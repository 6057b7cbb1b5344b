"""Tests frames: streams as columns. They need numpy; pandas, pyarrow and polars are tested if they are installed."""

import datetime
import importlib.util
import tempfile
import unittest

import situ
from situ import frames

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
                self.assertEqual(distance[row], distance.min())

    def test_notebooks_show_a_picture_and_a_table(self):
        page = self.store._repr_html_()
        self.assertEqual(page.count("<rect"), 5)
        self.assertIn("100 messages", page)
        self.assertIn("<th>Level</th>", self.store.join(["Level"])._repr_html_())
        expected = "<situ.Frame of 100 rows; time: datetime64[ns], value: float64>"
        self.assertEqual(repr(self.store.frame("Level")), expected)

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


if __name__ == "__main__":
    unittest.main()
