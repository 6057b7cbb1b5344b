"""Tests the parts of components without a worker. apps/situ_python/test runs whole components."""

import pathlib
import tempfile
import unittest

import situ
from situ import component, shared_memory, values

try:
    import numpy
except ImportError:
    numpy = None


class Left(situ.Component):
    def on_left(self, value, message):
        return None


class Any(Left):
    def on_message(self, value, message):
        return None


class ResultsTest(unittest.TestCase):
    def test_every_kind_of_result(self):
        self.assertEqual(component.list_results(None, 5), [])
        self.assertEqual(component.list_results({"a": 1}, 5), [(5, {"a": 1})])
        self.assertEqual(component.list_results([{"a": 1}, (7, {"a": 2})], 5), [(5, {"a": 1}), (7, {"a": 2})])

    def test_others_are_described(self):
        for returned, text in [(7, "a int, 7"), ([True], "a bool, True"), ([(True, {})], "a tuple"), ("x" * 99, "...")]:
            with self.assertRaisesRegex(TypeError, text.replace("...", r"\.\.\.")):
                component.list_results(returned, 5)


class HandlersTest(unittest.TestCase):
    def test_the_name_of_an_input_comes_first(self):
        handlers = component.find_handlers(Any(), ["left", "right"])
        self.assertEqual([handler.__name__ for handler in handlers], ["on_left", "on_message"])

    def test_a_missing_one_is_named(self):
        with self.assertRaisesRegex(TypeError, "define on_right.*it defines on_left"):
            component.find_handlers(Left(), ["left", "right"])

    def test_options_need_a_setup(self):
        Left().setup()
        with self.assertRaisesRegex(TypeError, "threshold"):
            Left().setup(threshold=1)


class SharedMemoryTest(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.path = pathlib.Path(folder.name) / "slots"

    def test_an_input_slot_is_in_use_while_a_view_of_it_exists(self):
        self.path.write_bytes(b"a" * 4096 + b"b" * 4096)
        slots = shared_memory.InputSlots(self.path)
        views = [slots.view(0, 0, 4096, 3), slots.view(1, 4096, 4096, 4096)]
        self.assertEqual(bytes(views[0]), b"aaa")
        self.assertTrue(views[0].readonly)
        part = views[1][10:20]
        del views
        self.assertEqual(slots.release(), [0])
        self.assertEqual(bytes(part), b"b" * 10)
        del part
        self.assertEqual(slots.release(), [1])
        self.assertEqual(slots.release(), [])

    def test_input_slots_outside_of_the_file_are_rejected(self):
        self.path.write_bytes(b"a" * 4096)
        slots = shared_memory.InputSlots(self.path)
        for place in [(0, 0, 8192, 5), (0, 1, 4096, 5), (0, 0, 4096, 4097), (0, 0, 4096, 0)]:
            with self.assertRaises(situ.Damaged):
                slots.view(*place)

    def test_output_slots_are_reused_and_limited(self):
        self.path.write_bytes(b"")
        slots = shared_memory.OutputSlots(self.path, 8192)
        self.assertEqual(slots.write([memoryview(b"ab"), memoryview(b"cd")]), (0, 0, 4096, 4))
        self.assertEqual(slots.write([memoryview(b"e")]), (1, 4096, 4096, 1))
        self.assertIsNone(slots.write([memoryview(b"f")]))
        slots.give_back([0])
        self.assertEqual(slots.write([memoryview(b"gh")]), (0, 0, 4096, 2))
        self.assertEqual(self.path.read_bytes()[:4], b"ghcd")

    @unittest.skipUnless(numpy, "numpy is not installed")
    def test_an_array_in_a_slot_is_returned_in_place(self):
        self.path.write_bytes(b"")
        part = situ.Component()
        part._memory = slots = shared_memory.OutputSlots(self.path, 5 * 65_536)
        array = part.empty((256, 256))
        array[:] = 7
        head, data = values.encode_parts(values.Tensor.from_array(array, copy=False))
        place = slots.write([head, data])
        self.assertEqual(place[:2], (0, 4_096 - head.nbytes))
        self.assertEqual(self.path.read_bytes()[place[1] :][: place[3]], bytes(head) + b"\7" * 65_536)
        with self.assertRaises(ValueError):
            array[0] = 1
        # The slot was read, but the array is still in use, and it can be returned once more.
        del data
        slots.give_back([0])
        other = part.empty((256, 256))
        self.assertEqual(slots.write(values.encode_parts(values.Tensor.from_array(array, copy=False)))[0], 0)
        slots.give_back([0])
        del array, other
        self.assertIn(slots.write([memoryview(bytes(65_537))])[0], (0, 1))
        # Small arrays, and large ones without room, are ordinary ones.
        self.assertIsNone(part.empty(10).base)
        self.assertEqual(part.empty((3, 65_536), "<f8").dtype, numpy.float64)
        self.assertIsNone(part.empty((3, 65_536), "<f8").base)

    def read_journal(self):
        raw = self.path.read_bytes()
        before, length = shared_memory.Journal.HEAD.unpack_from(raw)
        return before, raw[16 : 16 + length]

    def test_the_journal_contains_the_last_results(self):
        self.path.write_bytes(bytes(16 + 48))
        journal = shared_memory.Journal(self.path)
        results = [b"%03d" % number for number in range(1_000)]
        unsent = []
        for number, result in enumerate(results):
            if not journal.append(result):
                self.assertEqual(journal.take_unsent(), b"".join(unsent))
                unsent = []
                self.assertTrue(journal.append(result))
            unsent.append(result)
            before, kept = self.read_journal()
            self.assertEqual(kept, b"".join(results[before : number + 1]))
            # Without results that were not sent, at least the last ones remain.
            self.assertGreaterEqual(len(kept), min(number + 1, 5) * 3)

    def test_the_journal_counts_results_that_do_not_fit(self):
        self.path.write_bytes(bytes(16 + 16))
        journal = shared_memory.Journal(self.path)
        self.assertTrue(journal.append(b"abcd"))
        self.assertFalse(journal.append(bytes(20)))
        self.assertEqual(journal.take_unsent(), b"abcd")
        self.assertFalse(journal.append(bytes(20)))
        journal.skip_result()
        self.assertEqual(self.read_journal(), (2, b""))
        self.assertTrue(journal.append(b"e"))
        self.assertEqual(self.read_journal(), (2, b"e"))


if __name__ == "__main__":
    unittest.main()
