defmodule Situ.Bridge.Parquet do
  @moduledoc """
  Writes recordings as Parquet files for pandas, Polars, DuckDB and other programs that read tables, and reads such
  tables as streams.

      {:ok, counts} = Situ.Bridge.Parquet.export(store, "tables")      # tables/NAME.parquet, one per stream
      p |> Situ.Bridge.Parquet.read("levels.parquet") |> Situ.each(&IO.inspect/1)

  Each row is a message. Its columns are `originating_time` and `creation_time` (timestamps in nanoseconds, UTC), and
  `value`, or one column for each member of maps and structs, with nested members named `a.b`. Numbers, booleans,
  strings and bytes keep their types. Lists, and members whose type varies, are written as JSON. With `nested: true`,
  maps, structs and lists become nested columns. A stream is read twice, because its columns are known only at its
  end. Images, audio and other types with a codec cannot be written to tables.

  Columns of all types can be read, including lists, maps and structs, in all encodings and all compressions except
  LZO. A damaged file, or an unsupported feature such as encryption, is an error that names it. Decimals become floats,
  times of day and durations become nanoseconds, and UUIDs become strings. A row is a map of its columns; if its only
  column is `value`, the row is that value.

  A separate program reads and writes the files, so that a hostile file cannot stop the VM.
  """

  alias Situ.Bridge.Columnar
  alias Situ.Bridge.Columnar.TableOptions
  alias Situ.Bridge.Parquet.{File, PackedColumns, Writer}
  alias Situ.{Error, Store}

  @export [
            compression: [
              type: {:in, [:zstd, :snappy, :gzip, :none]},
              default: :zstd,
              doc: "How to compress pages."
            ],
            nested: [
              type: :boolean,
              default: false,
              doc: "Whether maps, structs and lists become nested columns."
            ]
          ] ++ TableOptions.export_options("row group")
  @read TableOptions.read_options()

  @doc """
  Writes streams of a recording into a folder, one file per stream, and returns `{:ok, %{name => rows}}`. Streams
  without messages, and streams of images, audio and other types with a codec, are skipped. Errors: `:not_writable`,
  `:io`, `:disk_full`.

  #{Situ.Options.docs(@export)}
  """
  @spec export(Store.t(), Path.t(), keyword()) ::
          {:ok, %{String.t() => non_neg_integer()}} | {:error, Error.t()}
  def export(store, folder, opts \\ []) do
    opts = Situ.Options.validate!(opts, @export)
    Columnar.export_streams(Writer, store, folder, ".parquet", opts)
  end

  @doc """
  Writes one stream of a recording into a file and returns `{:ok, rows}`. Options: `compression:` and `rows:` as in
  `export/3`; `from:`, `to:` and `skip_damage:` as in `Situ.Store.messages/3`; `progress:`, a function that receives
  the number of rows written so far.
  """
  @spec write(Store.t(), String.t(), Path.t(), keyword()) ::
          {:ok, non_neg_integer()} | {:error, Error.t()}
  def write(store, name, path, opts \\ []) do
    Columnar.write_stream(Writer, store, name, path, TableOptions.validate_write!(opts, @export))
  end

  @doc """
  Writes several streams of a recording as one table, joined on time, and returns `{:ok, rows}`. The table has a row
  for each message of the stream `on:`. Columns are named `STREAM`, or `STREAM.MEMBER` for members of maps and
  structs.

      Situ.Bridge.Parquet.join(store, "drive.parquet", on: "Speed", streams: ["Pose"], within: Situ.Time.ms(50))

  Other options are the same as for `write/4`.

  #{Situ.Options.docs(Situ.Bridge.Columnar.Join.join_options())}
  """
  @spec join(Store.t(), Path.t(), keyword()) :: {:ok, non_neg_integer()} | {:error, Error.t()}
  def join(store, path, opts) do
    Columnar.write_joined(Writer, store, path, TableOptions.validate_join!(opts, @export))
  end

  @doc ~S"""
  Writes messages from any source into a file and returns `{:ok, rows}`. `parts` is an enumerable of lists of
  messages. It is enumerated twice and must yield the same messages both times.

      iex> messages = for i <- 1..3, do: %Situ.Message{data: i / 2, originating_time: i, creation_time: i}
      iex> path = Path.join(System.tmp_dir!(), "situ-parts-#{System.unique_integer([:positive])}.parquet")
      iex> {:ok, 3} = Situ.Bridge.Parquet.write_messages([messages], path)
      iex> File.rm!(path)
      :ok
  """
  @spec write_messages(Enumerable.t(), Path.t(), keyword()) ::
          {:ok, non_neg_integer()} | {:error, Error.t()}
  def write_messages(parts, path, opts \\ []) do
    opts = Situ.Options.validate!(opts, Keyword.delete(@export, :streams))
    Columnar.write_messages(Writer, parts, path, opts)
  end

  @doc ~S"""
  Writes columns into a file and returns `{:ok, rows}`, without a term for each value. Columns are pairs of a name and
  values: `{:time | :integer | :float, bytes}` with 8 bytes for each value, `{:boolean, bytes}` with one byte for each,
  or `{kind, list}` with such a kind, `:text` or `:bytes`, in which `nil` is a missing value. Numbers are
  little-endian. Options: `compression:` and `rows:` as in `export/3`. Errors: `:not_writable`, `:io`, `:disk_full`.

      iex> path = Path.join(System.tmp_dir!(), "situ-columns-#{System.unique_integer([:positive])}.parquet")
      iex> x = for x <- [0.5, 1.5], into: <<>>, do: <<x::little-float-64>>
      iex> Situ.Bridge.Parquet.write_columns([{"x", {:float, x}}, {"name", {:text, ["a", nil]}}], path)
      {:ok, 2}
      iex> [%{"x" => {:float, ^x}, "name" => ["a", nil]}] = Enum.to_list(Situ.Bridge.Parquet.columns(path))
      iex> File.rm!(path)
      :ok
  """
  @spec write_columns([{String.t(), {atom(), binary() | list()}}], Path.t(), keyword()) ::
          {:ok, non_neg_integer()} | {:error, Error.t()}
  def write_columns(columns, path, opts \\ []) do
    opts = Situ.Options.validate!(opts, Keyword.drop(@export, [:streams, :nested]))
    PackedColumns.write_columns(columns, path, opts)
  end

  @doc """
  Returns the columns of a table as a lazy enumerable of maps, each with some rows. Values are packed as in
  `write_columns/3`, times as `:integer`. Columns with missing values, and columns of other types, are lists. Raises
  `Situ.Error`: `:io`, `:not_parquet`, `:no_column`.

  Options: `columns:`, the names of the columns to read; by default, all of them.
  """
  @spec columns(Path.t(), keyword()) :: Enumerable.t()
  def columns(path, opts \\ []), do: PackedColumns.stream_columns(path, opts[:columns])

  @doc """
  Adds a source with the rows of a table; it proposes a replay that starts at the first row. Rows are skipped if they
  have no time, or a time that is not later than the time of the previous row.

  #{Situ.Options.docs(@read)}
  """
  @spec read(Situ.Pipeline.t(), Path.t(), keyword()) :: Situ.Stream.t()
  def read(p, path, opts \\ []) do
    opts = Situ.Options.validate!(opts, @read)
    {source, opts} = Keyword.split(opts, [:type, :name])
    Situ.Bridge.File.replay_source(p, messages(path, opts), path, source)
  end

  @doc """
  Returns the columns of a file, and the names and types of the columns that are skipped because their types are not
  supported. If several columns have the same name, the later ones are numbered: `x`, `x_1`. Errors: `:io`,
  `:not_parquet`.
  """
  @spec list_columns(Path.t()) ::
          {:ok, %{columns: [String.t()], left_out: [{name :: String.t(), type :: String.t()}]}}
          | {:error, Error.t()}
  def list_columns(path), do: Columnar.list_columns(File, path)

  @doc """
  Returns the rows as a lazy enumerable of `{time, value}`. Memory holds one page of each requested column. Row groups
  outside of `from:` and `to:` are not read. Raises `Situ.Error`: `:io`, `:not_parquet`, `:no_column`.

  Options: `time:`, `columns:`, `from:` and `to:` as in `read/3`; `notice:`, a function that receives a
  sentence about skipped columns or rows. By default, these sentences are logged as warnings.
  """
  @spec messages(Path.t(), keyword()) :: Enumerable.t()
  def messages(path, opts \\ []), do: Columnar.stream_messages(File, path, opts)
end
