"""The other systems' own libraries for bin/bench bridge-*-python: WHAT N prints the rate and CPU time a message, us."""
import io
import json
import resource
import sys
import tempfile
import time


def cpu():
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def timed(n, fun):
    before, began = cpu(), time.monotonic()
    fun()
    print(n / (time.monotonic() - began), (cpu() - before) / n * 1e6)


def message_pack(n):
    import msgpack

    def run():
        for i in range(n):
            there = msgpack.packb({"message": {"n": i, "x": i / 3}, "originatingTime": 621355968000000000 + i})
            assert msgpack.unpackb(there)["message"]["n"] == i

    timed(n, run)


def protobuf(n):
    from foxglove_schemas_protobuf.Log_pb2 import Log

    def run():
        for i in range(n):
            stamp = {"seconds": i // 1_000, "nanos": i % 1_000}
            there = Log(timestamp=stamp, level=2, message="a message", name="bench", line=i).SerializeToString()
            assert Log.FromString(there).line == i

    timed(n, run)


def mcap(n):
    from mcap.reader import make_reader
    from mcap.writer import Writer

    file = io.BytesIO()

    def run():
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("S", "jsonschema", b'{"type":"object"}')
        channels = [writer.register_channel(f"/topic{c}", "json", schema) for c in range(100)]
        for i in range(n):
            payload = json.dumps({"n": i, "topic": i % 100}).encode()
            writer.add_message(channels[i % 100], log_time=i * 1_000, data=payload, publish_time=i * 1_000)
        writer.finish()
        file.seek(0)
        found = sum(json.loads(message.data)["n"] for _, _, message in make_reader(file).iter_messages())
        assert found == n * (n - 1) // 2

    timed(n, run)


def parquet(n):
    import polars

    with tempfile.NamedTemporaryFile(suffix=".parquet") as file:

        def run():
            rows = polars.DataFrame({"originating_time": range(1, n + 1), "value": range(1, n + 1)})
            rows.write_parquet(file.name, compression="uncompressed")
            assert polars.read_parquet(file.name)["value"].to_list()[-1] == n

        timed(n, run)


globals()[sys.argv[1]](int(sys.argv[2]))
