defmodule Situ.Bridge.Arrow do
  @moduledoc """
  Writes recordings as Arrow files (IPC, also called Feather), which Polars, pandas and DuckDB can memory-map, and
  reads such files as streams.

      {:ok, counts} = Situ.Bridge.Arrow.export(store, "tables")        # tables/NAME.arrow, one per stream
      p |> Situ.Bridge.Arrow.read("levels.arrow") |> Situ.each(&IO.inspect/1)

  Rows and columns are the same as in `Situ.Bridge.Parquet`. An Arrow file is larger, but faster to write and to read.
  Situ writes uncompressed batches. It reads Arrow files and Arrow streams with numbers, booleans, strings and bytes
  (including their view types), times, dates, decimals, dictionaries of these, and lists, maps and structs of all of
  them; buffers may be compressed with LZ4 or zstd. Columns of other types (unions, list views, run-end encoded
  columns, intervals, dictionaries of lists or structs) are skipped with a warning that names them. Requesting such a
  column, or reading a file that has no others, is an error.
  """

  alias Situ.Bridge.Arrow.{File, Writer}
  alias Situ.Bridge.Columnar
  alias Situ.Bridge.Columnar.TableOptions
  alias Situ.{Error, Store}

  @export TableOptions.export_options("batch")
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
    Columnar.export_streams(Writer, store, folder, ".arrow", opts)
  end

  @doc """
  Writes one stream of a recording into a file and returns `{:ok, rows}`. Options: `rows:` as in `export/3`; `from:`,
  `to:` and `skip_damage:` as in `Situ.Store.messages/3`; `progress:`, a function that receives the number of rows
  written so far.
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

      Situ.Bridge.Arrow.join(store, "drive.arrow", on: "Speed", streams: ["Pose"], within: Situ.Time.ms(50))

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
      iex> path = Path.join(System.tmp_dir!(), "situ-parts-#{System.unique_integer([:positive])}.arrow")
      iex> {:ok, 3} = Situ.Bridge.Arrow.write_messages([messages], path)
      iex> read = Enum.to_list(Situ.Bridge.Arrow.messages(path))
      iex> File.rm!(path)
      iex> read
      [{1, 0.5}, {2, 1.0}, {3, 1.5}]
  """
  @spec write_messages(Enumerable.t(), Path.t(), keyword()) ::
          {:ok, non_neg_integer()} | {:error, Error.t()}
  def write_messages(parts, path, opts \\ []) do
    opts = Situ.Options.validate!(opts, Keyword.delete(@export, :streams))
    Columnar.write_messages(Writer, parts, path, opts)
  end

  @doc """
  Adds a source with the rows of a file; it proposes a replay that starts at the first row. Rows are skipped if they
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
  `:not_arrow`.
  """
  @spec list_columns(Path.t()) ::
          {:ok, %{columns: [String.t()], left_out: [{name :: String.t(), type :: String.t()}]}}
          | {:error, Error.t()}
  def list_columns(path), do: Columnar.list_columns(File, path)

  @doc """
  Returns the rows as a lazy enumerable of `{time, value}`. Memory holds only a few rows at a time, or the requested
  columns of one batch if the batch is compressed. Skipped columns are logged. Raises `Situ.Error`: `:io`,
  `:not_arrow`, `:no_column`.

  Options: `time:` and `columns:` as in `read/3`; `notice:`, a function that receives a sentence about skipped columns
  or rows. By default, these sentences are logged as warnings.
  """
  @spec messages(Path.t(), keyword()) :: Enumerable.t()
  def messages(path, opts \\ []), do: Columnar.stream_messages(File, path, opts)
end
