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
for compression in ("uncompressed", "snappy", "gzip", "zstd"):
    read.write_parquet(f"{folder}/theirs-polars-{compression}.parquet", compression=compression)
    duckdb.sql(f"copy (from '{table}') to '{folder}/theirs-duckdb-{compression}.parquet' (format parquet, compression {compression})")
