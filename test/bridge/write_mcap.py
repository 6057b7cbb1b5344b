"""Writes the same 500 messages as MCAP with all options of the mcap package."""
import json
import sys

from mcap.writer import CompressionType, IndexType, Writer

OPTIONS = {
    "plain": dict(use_chunking=False),
    "zstd": dict(compression=CompressionType.ZSTD, chunk_size=3000),
    "lz4": dict(compression=CompressionType.LZ4, chunk_size=3000),
    "none": dict(compression=CompressionType.NONE, chunk_size=3000),
    "no-index": dict(index_types=IndexType.NONE, chunk_size=3000),
    "no-statistics": dict(use_statistics=False, chunk_size=3000),
    "no-summary": dict(use_statistics=False, index_types=IndexType.NONE, use_summary_offsets=False, repeat_channels=False, repeat_schemas=False),
}
for name, options in OPTIONS.items():
    with open(f"{sys.argv[1]}/theirs-{name}.mcap", "wb") as file:
        writer = Writer(file, **options)
        writer.start()
        schema = writer.register_schema("Value", "jsonschema", b'{"type":"object"}')
        channel = writer.register_channel("/values", "json", schema)
        other = writer.register_channel("/other", "json", schema)
        for i in range(500):
            time = 1_000_000_000 + i * 1_000_000
            writer.add_message(channel, log_time=time, publish_time=time, sequence=i, data=json.dumps({"value": i / 4}).encode())
            writer.add_message(other, log_time=time, publish_time=time, data=b'{"other":true}')
        writer.add_attachment(log_time=1, create_time=1, name="a.txt", media_type="text/plain", data=b"x")
        writer.finish()
