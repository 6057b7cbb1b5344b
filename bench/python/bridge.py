"""Measures the other systems' own libraries, for bin/bench bridge-*-python.

bridge.py BENCHMARK N prints the rate and the CPU time per message in us.
"""
import io
import json
import resource
import sys
import tempfile
import time


def cpu_time():
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def measure_rate(n, fun):
    """Runs `fun`, which handles `n` messages, and prints their rate and CPU time."""
    before, began = cpu_time(), time.monotonic()
    fun()
    print(n / (time.monotonic() - began), (cpu_time() - before) / n * 1e6)


def bench_message_pack(n):
    import msgpack

    def round_trip():
        for i in range(n):
            encoded = msgpack.packb({"message": {"n": i, "x": i / 3}, "originatingTime": 621355968000000000 + i})
            assert msgpack.unpackb(encoded)["message"]["n"] == i

    measure_rate(n, round_trip)


def bench_protobuf(n):
    from foxglove_schemas_protobuf.Log_pb2 import Log

    def round_trip():
        for i in range(n):
            stamp = {"seconds": i // 1_000, "nanos": i % 1_000}
            encoded = Log(timestamp=stamp, level=2, message="a message", name="bench", line=i).SerializeToString()
            assert Log.FromString(encoded).line == i

    measure_rate(n, round_trip)


def bench_mcap(n):
    from mcap.reader import make_reader
    from mcap.writer import Writer

    file = io.BytesIO()

    def round_trip():
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

    measure_rate(n, round_trip)


def bench_parquet(n):
    import polars

    with tempfile.NamedTemporaryFile(suffix=".parquet") as file:

        def round_trip():
            rows = polars.DataFrame({"originating_time": range(1, n + 1), "value": range(1, n + 1)})
            rows.write_parquet(file.name, compression="uncompressed")
            assert polars.read_parquet(file.name)["value"].to_list()[-1] == n

        measure_rate(n, round_trip)


BENCHMARKS = {
    "message_pack": bench_message_pack,
    "protobuf": bench_protobuf,
    "mcap": bench_mcap,
    "parquet": bench_parquet,
}
BENCHMARKS[sys.argv[1]](int(sys.argv[2]))
