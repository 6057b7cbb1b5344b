"""Reads the golden recordings of Situ (test/golden), and compares every value with the expected ones."""
import glob
import hashlib
import json
import os
import unittest

import situ
from situ import terms, values

ROOT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "../../../test/golden")


def to_json(value):
    """The same form as in test/golden/values.exs."""
    if isinstance(value, terms.Struct):
        fields = {key: to_json(field) for key, field in value.items()}
        return {**fields, "type": value.module}
    if isinstance(value, dict):
        return {str(key): to_json(field) for key, field in value.items()}
    if isinstance(value, (list, tuple)):
        return [to_json(element) for element in value]
    if isinstance(value, (bytes, bytearray, memoryview)):
        try:
            return bytes(value).decode()
        except UnicodeDecodeError:
            return {"bytes": bytes(value).hex().upper()}
    if type(value).__module__ == values.__name__:
        encoded = b"".join(bytes(part) for part in values.encode_parts(value))
        return {"type": value.TYPE, "sha256": hashlib.sha256(encoded).hexdigest().upper()}
    return value


class GoldenTest(unittest.TestCase):
    maxDiff = 2000

    def test_reads_every_message(self):
        files = glob.glob(os.path.join(ROOT, "*/expected.json"))
        self.assertTrue(files, "test/golden is missing")
        for file in files:
            with open(file, encoding="utf-8") as text:
                expected = json.load(text)
            for name, streams in expected.items():
                with self.subTest(name):
                    self.compare(os.path.join(os.path.dirname(file), "recordings", name), streams)

    def compare(self, path, streams):
        store = situ.open(path)
        self.assertEqual(set(streams), set(store.streams))
        for stream, messages in streams.items():
            found = store.read(stream, skip_damage="damaged" in path)
            self.assertEqual(messages, [[m.time, m.creation, to_json(m.data)] for m in found], stream)


if __name__ == "__main__":
    unittest.main()
