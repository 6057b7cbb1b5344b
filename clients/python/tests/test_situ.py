"""Tests that written messages can be read back, and that malicious files are rejected.

The tests use the standard library and, if it is installed, numpy.
"""
import base64
import json
import math
import os
import random
import shutil
import struct
import subprocess
import sys
import tempfile
import unittest

import situ
from situ import binary, formats, terms, values
from situ.binary import Damaged, Missing

try:
    import numpy as np
except ImportError:
    np = None

CODED = [
    situ.Image(2, 2, "gray8", 2, b"abcd"),
    situ.DepthImage(1, 1, 2, 0.001, "plane", b"ab"),
    situ.EncodedImage("jpeg", 1, 2, b"\xff\xd8"),
    situ.VideoPacket("h264", 3, 5, 4, "bgr24", b"\x00\x00\x01\x41"),
    situ.AudioBuffer(16_000, 2, "s16", b"abcd"),
    situ.Tensor("<f4", (2, 1), b"01234567"),
    situ.PointCloud(b"0123456789ab", b"rgb"),
    situ.PointCloud(b"0123456789ab", None, b"1234"),
    situ.PointCloud(b"0123456789ab", b"rgb", b"1234"),
    situ.Pose((1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0)),
]
PLAIN = [0, -1, 255, 1 << 40, -(1 << 200), 1.5, True, None, "ä", b"\xff\x00", [1, [2]], (1, "x")]
PLAIN += [{"a": [None], "b": {}}, []]


class TermTest(unittest.TestCase):
    def test_decodes_every_encoded_kind_of_term(self):
        for term in [*PLAIN, situ.Atom("hello"), situ.Struct("My.Point", {"x": 1.0})]:
            self.assertEqual(terms.decode_term(terms.encode_term(term)), term)
        self.assertTrue(math.isnan(terms.decode_term(terms.encode_term(math.nan))))
        self.assertEqual(terms.decode_term(terms.encode_term(situ.Struct("My.Point", {"x": 1.0}))).module, "My.Point")

    def test_rejects_functions_and_processes(self):
        for tag in (80, 82, 88, 89, 103, 112, 113):
            with self.assertRaises(Damaged):
                terms.decode_term(bytes([131, tag]) + bytes(40))
        with self.assertRaises(TypeError):
            terms.encode_term(object())


class SegmentTest(unittest.TestCase):
    """Recordings in segments. The writer of this package writes stores, which the tests mark as segments."""

    def write_segment(self, root, run, times, name="n", close=True):
        writer = situ.create("hall", root)
        writer._add_record({"kind": "piece", "every": 10, "run": run})
        writer._add_record({"kind": "piece"})
        for time in times:
            writer.write(name, time, (run, time))
        writer.commit()
        if close:
            writer.close()
        return writer

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.root, self.path = folder.name, os.path.join(folder.name, "hall")

    def test_reads_all_segments_as_one_recording(self):
        for first in (1, 11, 21):
            self.write_segment(self.root, "a", range(first, first + 9))
        self.write_segment(self.root, "b", [51], name="late")
        store = situ.open(self.path)
        self.assertEqual((store.name, store.state, len(store.segments)), ("hall", "closed", 4))
        self.assertEqual([m.time for m in store.read("n")], [*range(1, 10), *range(11, 20), *range(21, 30)])
        self.assertEqual([m.time for m in store.read("n", 8, 12)], [8, 9, 11, 12])
        self.assertEqual([m.time for m in store.read("late")], [51])
        stream = store.streams["n"]
        self.assertEqual((stream.count, stream.first, stream.last), (27, 1, 29))
        with self.assertRaises(KeyError):
            next(store.read("none"))
        self.assertEqual(len(list(situ.open(self.path + ".0001").read("n"))), 9)

    def test_a_later_run_replaces_what_an_earlier_one_recorded_for_the_same_times(self):
        self.write_segment(self.root, "a", range(1, 10))
        self.write_segment(self.root, "a", range(11, 20))
        self.write_segment(self.root, "b", range(6, 9))
        store = situ.open(self.path)
        wanted = [("a", time) for time in range(1, 6)] + [("b", time) for time in range(6, 9)]
        self.assertEqual([tuple(m.data) for m in store.read("n")], wanted)
        self.assertEqual(store.streams["n"].count, 8)

    def test_a_version_that_is_not_a_segment_is_a_recording_of_its_own(self):
        self.write_segment(self.root, "a", [1])
        with situ.create("hall", self.root) as writer:
            writer.write("other", 5, 5)
        self.assertEqual(list(situ.open(self.path).streams), ["other"])
        self.write_segment(self.root, "a", [2])
        self.assertEqual([m.time for m in situ.open(self.path).read("n")], [1, 2])

    def test_follows_a_recording_into_new_segments(self):
        first = self.write_segment(self.root, "a", [1], close=False)
        messages = situ.open(self.path).read("n", follow=True)
        self.assertEqual(next(messages).time, 1)
        second = self.write_segment(self.root, "a", [11], close=False)
        first.close()
        self.assertEqual(next(messages).time, 11)
        second.close()
        self.assertEqual(list(messages), [])

    def test_says_that_a_segment_was_deleted_before_it_was_read(self):
        for first in (1, 11, 21):
            self.write_segment(self.root, "a", range(first, first + 9))
        # The native core maps the files, and can read them even after their deletion.
        messages = situ.open(self.path, core=False).read("n")
        self.assertEqual(next(messages).time, 1)
        shutil.rmtree(self.path + ".0001")
        with self.assertWarns(situ.DeletedWarning):
            self.assertEqual([m.time for m in messages], [*range(2, 10), *range(21, 30)])

    def test_reads_the_other_segments_if_one_is_damaged(self):
        for first in (1, 11, 21):
            self.write_segment(self.root, "a", [first])
        for number in (1, 2):
            with open(f"{self.path}.000{number}/index.situ", "r+b") as file:
                file.write(b"nonsense")
        store = situ.open(self.path)
        self.assertEqual([m.time for m in store.read("n")], [1])
        self.assertEqual(len(store.damage), 2)

    @unittest.skipIf(np is None, "numpy is not installed")
    def test_returns_columns_of_all_segments(self):
        for first in (1, 11):
            writer = situ.create("hall", self.root)
            writer._add_record({"kind": "piece", "run": "a"})
            for time in range(first, first + 9):
                writer.write("x", time, time / 2)
            writer.close()
        times, data = situ.open(self.path).array("x", 5, 15)
        self.assertEqual(list(times), [5, 6, 7, 8, 9, 11, 12, 13, 14, 15])
        self.assertEqual(list(data), [time / 2 for time in times])


class MaliciousInputTest(unittest.TestCase):
    def test_decodes_or_rejects_mutated_bytes(self):
        dice = random.Random(1)
        samples = [("situ", formats.encode_message("situ", 5, value)) for value in [*PLAIN, *CODED]]
        samples += [("json", formats.encode_message("json", 5, {"a": [1, 2.5, "x"]}))]
        for n in range(20_000):
            format, sample = samples[n % len(samples)]
            raw = bytearray(sample)
            for _ in range(dice.randint(1, 3)):
                raw[dice.randrange(len(raw))] = dice.randrange(256)
            raw = bytes(raw[: dice.randint(0, len(raw))]) if dice.random() < 0.3 else bytes(raw)
            try:
                formats.decode_message(format, raw, 0)
            except Damaged:
                pass

    def test_reads_or_rejects_a_store_with_a_flipped_bit(self):
        with tempfile.TemporaryDirectory() as root:
            with situ.create("a", root) as store:
                for n, value in enumerate(PLAIN + CODED):
                    store.write("s", n, value)
            dice = random.Random(2)
            for name in ("index.situ", "data-000000.situ"):
                path = os.path.join(root, "a.0000", name)
                intact = open(path, "rb").read()
                for _ in range(500):
                    raw = bytearray(intact)
                    raw[dice.randrange(len(raw))] ^= 1 << dice.randrange(8)
                    open(path, "wb").write(raw)
                    try:
                        for message in situ.open(os.path.join(root, "a")).read("s"):
                            self.assertIsNotNone(message)
                    except (Damaged, Missing, KeyError):
                        pass
                open(path, "wb").write(intact)


class DamageTest(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        with situ.create("a", folder.name, core=False) as store:
            store.write("first", 1, 1)
            for n in range(3_000):
                store.write("n", n, n)
        self.path = os.path.join(folder.name, "a.0000")

    def flip_bit(self, name, at, bit=0):
        with open(os.path.join(self.path, name), "r+b") as file:
            file.seek(at)
            (byte,) = file.read(1)
            file.seek(at)
            file.write(bytes([byte ^ 1 << bit]))

    def find_entries(self, stream):
        return [e for e in situ.open(self.path, core=False)._files.entries if e["stream"] == stream]

    def test_skips_and_lists_a_damaged_index_entry(self):
        written = range(3_000)
        entries = self.find_entries(2)
        self.assertEqual([e["count"] for e in entries], [1_024, 1_024, 952])
        self.flip_bit("index.situ", 4_096 + 64 * entries[1]["number"] + 20)
        store = situ.open(self.path, core=False)
        self.assertEqual(store.damage, [f"the checksum of index entry {entries[1]['number']} does not match"])
        self.assertEqual([m.data for m in store.read("n")], [*written[:1_024], *written[2_048:]])
        self.assertEqual(store.streams["n"].count, 1_976)
        self.assertEqual([m.data for m in store.read("first")], [1])

    def test_reads_the_rest_after_any_flipped_bit_of_the_index(self):
        header = [at for at in range(12, 64)]
        entries = range(4_096, 4_096 + 64 * len(situ.open(self.path, core=False)._files.entries))
        for at in [*header, *entries[::7]]:
            self.flip_bit("index.situ", at, at % 8)
            store = situ.open(self.path)
            self.assertEqual(len(store.damage), 1)
            got = sum(len(list(store.read(name))) for name in store.streams)
            self.assertGreaterEqual(got, 3_001 - 1_024)
            self.flip_bit("index.situ", at, at % 8)
        self.assertEqual(situ.open(self.path).damage, [])

    def test_raises_for_a_damaged_chunk_or_skips_it(self):
        damaged = self.find_entries(2)[0]
        self.flip_bit("data-000000.situ", damaged["offset"] + 200)
        store = situ.open(self.path)
        with self.assertRaises(Damaged):
            list(store.read("n"))
        self.assertEqual([m.data for m in store.read("n", skip_damage=True)], list(range(1_024, 3_000)))
        self.assertEqual(len(store.damage), 1)
        self.assertIn("checksum", store.damage[0])

    def test_reads_streams_whose_catalog_records_are_damaged(self):
        self.flip_bit("data-000000.situ", self.find_entries(0)[1]["offset"] + 120)
        store = situ.open(self.path)
        self.assertEqual(len(store.damage), 1)
        self.assertEqual(list(store.streams), ["stream 1", "stream 2"])
        self.assertEqual(len(list(store.read("stream 2"))), 3_000)


class ChecksumTest(unittest.TestCase):
    def test_all_implementations_agree(self):
        implementations = [binary._plain_crc32c, binary.crc32c] + ([binary._build_numpy_crc32c(np)] if np else [])
        dice = random.Random(4)
        for length in (0, 1, 2, 9, 1_023, 1_024, 16_385, 150_001):
            raw = dice.randbytes(length)
            self.assertEqual(len({crc32c(raw) for crc32c in implementations}), 1, length)
        self.assertTrue(all(crc32c(b"123456789") == 0xE3069283 for crc32c in implementations))


class StoreTest(unittest.TestCase):
    def test_reads_written_messages(self):
        with tempfile.TemporaryDirectory() as root:
            with situ.create("lobby", root) as store:
                for n in range(3_000):
                    store.write("ints", n * 7, n - 5)
                    store.write("mixed", n, PLAIN[n % len(PLAIN)])
                    store.write("coded", n, CODED[n % len(CODED)])
                store.write("large", 1, bytes(100_000))
                with self.assertRaises(ValueError):
                    store.write("ints", 0, 1)
                with self.assertRaises(TypeError):
                    store.write("bad", 0, object())
            store = situ.open(os.path.join(root, "lobby"))
            self.assertTrue(store.closed)
            self.assertEqual([m.data for m in store.read("ints")], list(range(-5, 2_995)))
            self.assertEqual([m.time for m in store.read("ints", 70, 105)], [70, 77, 84, 91, 98, 105])
            self.assertEqual([m.data for m in store.read("mixed")], [PLAIN[n % len(PLAIN)] for n in range(3_000)])
            self.assertEqual([m.data for m in store.read("coded")], [CODED[n % len(CODED)] for n in range(3_000)])
            self.assertEqual(next(store.read("large")).data, bytes(100_000))
            with self.assertRaises(KeyError):
                next(store.read("nothing"))

    def test_rejects_invalid_times_without_losing_messages(self):
        with tempfile.TemporaryDirectory() as root:
            with situ.create("times", root) as store:
                store.write("n", -(10**18), 1)
                for time, error in ((1.5e9, TypeError), (2**63, ValueError), (None, TypeError)):
                    with self.assertRaises(error):
                        store.write("n", time, 2)
                with self.assertRaises(TypeError):
                    store.write("n", 5, 2, creation=1.5)
                with self.assertRaises(TypeError):
                    store.write("set", 5, {1})
            store = situ.open(os.path.join(root, "times"))
            self.assertEqual([(m.time, m.data) for m in store.read("n")], [(-(10**18), 1)])
            self.assertEqual(list(store.streams), ["n"])

    def test_reads_a_store_that_is_being_written(self):
        with tempfile.TemporaryDirectory() as root:
            writer = situ.create("live", root)
            writer.write("n", 1, 1)
            writer.commit()
            messages = situ.open(os.path.join(root, "live")).read("n", follow=True)
            self.assertEqual(next(messages).data, 1)
            writer.write("n", 2, 2)
            writer.close()
            self.assertEqual([m.data for m in messages], [2])

    def test_stops_following_after_the_writer_is_killed(self):
        program = """if 1:
            import sys, situ
            writer = situ.create("live", sys.argv[1])
            writer.write("n", 1, 1)
            writer.commit()
            print("written", flush=True)
            sys.stdin.read()
        """
        with tempfile.TemporaryDirectory() as root:
            command = [sys.executable, "-c", program, root]
            environment = {**os.environ, "PYTHONPATH": os.path.dirname(os.path.dirname(situ.__file__))}
            with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment) as writer:
                self.assertEqual(writer.stdout.readline(), b"written\n")
                store = situ.open(os.path.join(root, "live"))
                messages = store.read("n", follow=True)
                self.assertEqual(next(messages).data, 1)
                self.assertEqual(store.state, "live")
                writer.kill()
                writer.wait()
                with self.assertWarns(situ.AbandonedWarning):
                    self.assertEqual(list(messages), [])
                self.assertEqual(store.state, "abandoned")

    def test_reads_the_metadata_of_a_stream(self):
        with tempfile.TemporaryDirectory() as root:
            with situ.create("a", root) as store:
                store.write("n", 1, 1)
                term = base64.b64encode(terms.encode_term({"rate": 16_000})).decode()
                store._add_record({"kind": "metadata", "id": 1, "type": "map", "term": term})
            store = situ.open(os.path.join(root, "a"))
            self.assertEqual(store.streams["n"].metadata, {"rate": 16_000})
            self.assertGreater(store.created, 0)

    def test_repr_abbreviates_long_bytes(self):
        image = situ.Image(100, 100, "gray8", 100, bytes(10_000))
        expected = "Image(width=100, height=100, format='gray8', stride=100, data=<10000 bytes>)"
        self.assertEqual(repr(image), expected)
        with tempfile.TemporaryDirectory() as root:
            situ.create("a", root).close()
            self.assertIn("'a' at ", repr(situ.open(os.path.join(root, "a"))))

    def test_datasets_merge_the_edits_of_others(self):
        with tempfile.TemporaryDirectory() as root:
            path = os.path.join(root, "study.json")
            situ.Dataset.create(path)
            one, two = situ.Dataset.open(path), situ.Dataset.open(path)
            one.add_session("one", age=30)
            two.add_session("two")
            two.document["tags"].append("pilot")
            one.save()
            two.save()
            self.assertEqual(list(two.sessions), ["one", "two"])
            one.document["metadata"]["lab"] = "A"
            one.sessions["one"].metadata["age"] = 31
            one.save()
            two.sessions["one"].metadata["age"] = 32
            with self.assertRaisesRegex(situ.ConflictError, "age"):
                two.save()
            # An edit of the file itself is kept, and so is an edit that it did not contain.
            with open(path) as file:
                text = file.read()
            one.document["tags"].append("late")
            one.save()
            with open(path, "w") as file:
                file.write(text.replace('"A"', '"B"'))
            again = situ.Dataset.open(path)
            self.assertEqual((again.document["metadata"], again.document["tags"]), ({"lab": "B"}, ["pilot", "late"]))
            again.add_session("three")
            again.save()
            again.document["tags"].append("later")
            again.save()
            # An older file that is put back replaces the content.
            with open(path, "w") as file:
                file.write(text)
            self.assertEqual(situ.Dataset.open(path).document["metadata"], {"lab": "A"})
            with open(path + ".edits") as file:
                kinds = [json.loads(line[9:]).get("kind") for line in file]
            self.assertEqual(kinds, [None, None, "edit", "edit", "edit", "edit", "outside", "edit", "edit"])

    def test_datasets_keep_unknown_members(self):
        with tempfile.TemporaryDirectory() as root:
            situ.create("a", root).close()
            dataset = situ.Dataset.create(os.path.join(root, "study.json"))
            dataset.document["ours"] = {"kept": True}
            dataset.add_session("one").add(os.path.join(root, "a"))
            dataset.save()
            again = situ.Dataset.open(dataset.path)
            self.assertEqual(again.document["ours"], {"kept": True})
            self.assertEqual(again.sessions["one"].partitions["a"].open().name, "a")


@unittest.skipUnless(np is not None, "numpy is not installed")
class ArrayTest(unittest.TestCase):
    def test_arrays_equal_the_messages_that_are_read_singly(self):
        streams = {
            "ints": [0, -1, 63, -64, 1 << 40, (1 << 63) - 1, -(1 << 63)] * 400,
            "floats": [n / 7 for n in range(2_500)],
            "truths": [n % 3 == 0 for n in range(2_500)],
            "both": [n if n % 2 else n / 2 for n in range(50)],
            "unknown": [True, None, False],
            "texts": ["a", "bc"],
        }
        with tempfile.TemporaryDirectory() as root:
            with situ.create("numbers", root) as store:
                for name, data in streams.items():
                    for n, value in enumerate(data):
                        store.write(name, n * 1_000_003 - 10**12, value)
            store = situ.open(os.path.join(root, "numbers"))
            for name, data in streams.items():
                times, got = store.array(name)
                self.assertEqual(times.tolist(), [n * 1_000_003 - 10**12 for n in range(len(data))])
                self.assertEqual(got.tolist(), data)
                for start, stop in ((None, times[1]), (times[1], None), (times[1] + 1, times[-1]), (5, 9)):
                    one_by_one = [m.data for m in store.read(name, start, stop)]
                    self.assertEqual(store.array(name, start, stop)[1].tolist(), one_by_one)
            self.assertEqual(store.array("floats")[1].dtype, np.float64)
            self.assertEqual(store.array("ints")[1].dtype, np.int64)
            self.assertEqual(store.array("truths")[1].dtype, np.bool_)

    def test_writes_numpy_scalars_as_numbers(self):
        with tempfile.TemporaryDirectory() as root:
            with situ.create("numbers", root) as store:
                scalars = {"i": np.int64(7), "f": np.float32(1.5), "b": np.bool_(True), "z": np.array(3)}
                for name, value in scalars.items():
                    store.write(name, np.int64(5), value)
            store = situ.open(os.path.join(root, "numbers"))
            got = {name: (s.type, next(store.read(name)).data) for name, s in store.streams.items()}
            expected = {"i": (":integer", 7), "f": (":float", 1.5), "b": (":boolean", True), "z": (":integer", 3)}
            self.assertEqual(got, expected)

    def test_images_convert_to_arrays(self):
        array = np.arange(2 * 3 * 3, dtype="u1").reshape(2, 3, 3)
        image = situ.Image.from_array(array)
        self.assertTrue((image.array == array).all() and (image.rgb == array).all())
        bgr = situ.Image.from_array(array, "bgr24")
        self.assertTrue((bgr.rgb == array[:, :, ::-1]).all())
        padded = situ.Image(1, 2, "gray8", 4, b"a...b...")
        self.assertEqual(padded.array.tolist(), [[97], [98]])

    def test_audio_of_24_bits_converts_to_int32(self):
        audio = situ.AudioBuffer(8_000, 1, "s24", struct.pack("<i", -2)[:3] + struct.pack("<i", 8_388_607)[:3])
        self.assertEqual(audio.array.ravel().tolist(), [-2, 8_388_607])

    def test_arrays_are_written_as_tensors(self):
        arrays = [np.eye(3), np.zeros((2, 0, 3), "f4"), np.array([True, False]), np.arange(4, dtype=">i2")]
        for array in [*arrays, np.ones(2, "f2")]:
            again = values.Tensor.decode(values.to_writable(array).encode()).array
            self.assertTrue((again == array).all() and again.shape == array.shape)
        bf16 = values.Tensor("bf16", (1,), struct.pack("<f", 1.5)[2:])
        self.assertEqual(bf16.array.tolist(), [1.5])


if __name__ == "__main__":
    unittest.main()
