"""Reads Situ's table with Polars and DuckDB, and writes it with all their compressions. FOLDER."""
import sys

import duckdb
import polars

folder = sys.argv[1]
table = f"{folder}/Rows.parquet"
read = polars.read_parquet(table)
assert read.height == 1_000, read
assert read["n"].to_list() == list(range(1, 1_001))
assert read["t"].to_list() == [None if n % 3 == 0 else f"text {n % 10}" for n in range(1, 1_001)]
assert read["p.x"].to_list() == [n / 4 for n in range(1, 1_001)]
assert str(read["originating_time"].dtype) == "Datetime(time_unit='ns', time_zone='UTC')", read.dtypes
assert read["originating_time"].dt.epoch("ns").to_list() == [n * 1_000 for n in range(1, 1_001)]
rows = duckdb.sql(f"select n, t, \"p.x\", b, epoch_ns(originating_time) from '{table}' where n = 7").fetchall()
assert rows == [(7, "text 7", 1.75, False, 7_000)], rows
assert polars.read_parquet(f"{folder}/gz/Rows.parquet").equals(read)
arrow = polars.read_ipc(f"{folder}/Rows.arrow")
assert arrow.equals(read), arrow
for compression in ("uncompressed", "lz4", "zstd"):
    read.write_ipc(f"{folder}/theirs-{compression}.arrow", compression=compression)
    read.write_ipc_stream(f"{folder}/theirs-{compression}.arrows", compression=compression)
nested = polars.read_parquet(f"{folder}/nested.parquet")
assert nested["p"].to_list() == [{"x": n / 4} for n in range(1, 1_001)]
assert nested["l"].to_list() == [[] if n % 3 == 0 else [n, None] for n in range(1, 1_001)]
assert duckdb.sql(f"select sum(p.x), sum(len(l)) from '{folder}/nested.parquet'").fetchall() == [(125_125.0, 1_334)]
for compression in ("uncompressed", "snappy", "gzip", "zstd", "lz4", "brotli"):
    read.write_parquet(f"{folder}/theirs-polars-{compression}.parquet", compression=compression)
for compression in ("uncompressed", "snappy", "gzip", "zstd", "lz4_raw", "brotli"):
    duckdb.sql(f"copy (from '{table}') to '{folder}/theirs-duckdb-{compression}.parquet' (format parquet, compression {compression})")
