defmodule Situ.Bridge.Parquet do
  @export [
    streams: [
      type: {:optional, {:list, :string}},
      default: nil,
      doc: "The streams wanted; all by default."
    ],
    compression: [type: {:in, [:none, :gzip]}, default: :none, doc: "How pages are packed."],
    rows: [type: :pos_integer, default: 100_000, doc: "The most rows of a row group."]
  ]
  @read [
    time: [
      type: {:optional, :string},
      default: nil,
      doc:
        "The column of originating times (nanoseconds, if its type says nothing else); by default " <>
          "`originating_time`, or else the first one of times."
    ],
    columns: [
      type: {:optional, {:list, :string}},
      default: nil,
      doc: "The columns wanted; all by default."
    ],
    type: [type: :any, default: :any, doc: "Type of the stream."],
    name: [type: :string, doc: "The component's name."]
  ]

  @moduledoc """
  Recordings as Parquet files, for pandas, Polars, DuckDB and whatever else reads tables; and such tables as streams.

      {:ok, counts} = Situ.Bridge.Parquet.export(store, "tables")      # tables/NAME.parquet, one a stream
      p |> Situ.Bridge.Parquet.read("levels.parquet") |> Situ.each(&IO.inspect/1)

  A row is a message: `originating_time` and `creation_time` (timestamps in nanoseconds, UTC), and `value`, or a column
  for each member of maps and structs, those of nested ones as `a.b`. Numbers, booleans, texts and bytes stay such;
  lists, and members that are now this and now that, are JSON. A stream is gone through twice: what its columns are is
  known at the end only. Pictures and sound (what has a codec of its own) are not put into tables.

  Read are columns of all types, lists, maps and structs too, plain or packed by Snappy, gzip, zstd or LZ4, in all
  encodings but the abandoned BIT_PACKED; another one is an error that names it. Decimals are floats, times of a day and
  spans nanoseconds, UUIDs texts. A row is a map of its columns, or of the one column `value` the value.

  ## Options of `export/3`

  #{Situ.Options.docs(@export)}
  """
  alias Situ.Bridge.Columnar
  alias Situ.Bridge.Parquet.{File, Writer}
  alias Situ.{Error, Store}

  @doc """
  Writes streams of a recording into a folder, a file each: `{:ok, %{name => rows}}`. Streams without messages, and
  those of pictures, sound and the like, are left out. Errors: `:not_writable`, `:io`, `:disk_full`.
  """
  @spec export(Store.t(), Path.t(), keyword()) ::
          {:ok, %{String.t() => non_neg_integer()}} | {:error, Error.t()}
  def export(store, folder, opts \\ []) do
    opts = Situ.Options.validate!(opts, @export)
    Columnar.export(Writer, store, folder, ".parquet", opts)
  end

  @doc """
  Writes one stream of a recording into a file: `{:ok, rows}`. Options: `compression:` and `rows:` as `export/3`;
  `from:`, `to:`, `skip_damage:` as `Situ.Store.messages/3`; `progress:`, a function of the rows written so far.
  """
  @spec write(Store.t(), String.t(), Path.t(), keyword()) ::
          {:ok, non_neg_integer()} | {:error, Error.t()}
  def write(store, name, path, opts \\ []) do
    {others, opts} = Keyword.split(opts, [:from, :to, :skip_damage, :progress])
    opts = Situ.Options.validate!(opts, Keyword.delete(@export, :streams))
    Columnar.write(Writer, store, name, path, opts ++ others)
  end

  @doc """
  Writes several streams of a recording as one table: `{:ok, rows}`, a row for each message of one of them, joined on
  time. A column is called like its stream, that of a member `STREAM.MEMBER`.

      Situ.Bridge.Parquet.join(store, "drive.parquet", on: "Speed", streams: ["Pose"], within: Situ.Time.ms(50))

  Other options as `write/4`.

  #{Situ.Options.docs(Situ.Bridge.Columnar.Joined.options())}
  """
  @spec join(Store.t(), Path.t(), keyword()) :: {:ok, non_neg_integer()} | {:error, Error.t()}
  def join(store, path, opts) do
    {others, opts} = Keyword.split(opts, [:from, :to, :skip_damage, :progress])
    schema = Keyword.merge(@export, Columnar.Joined.options())
    Columnar.join(Writer, store, path, Situ.Options.validate!(opts, schema) ++ others)
  end

  @doc ~S"""
  Writes messages from anywhere into a file: `{:ok, rows}`. `parts` are lists of messages; they are gone through twice,
  so enumerating them again must give the same ones.

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

  @doc """
  A source of a table's rows; it proposes a replay from the first one on. Rows without a time, and those that are not
  later than the one before, are left out.

  #{Situ.Options.docs(@read)}
  """
  @spec read(Situ.Pipeline.t(), Path.t(), keyword()) :: Situ.Stream.t()
  def read(p, path, opts \\ []) do
    opts = Situ.Options.validate!(opts, @read)
    Columnar.read(p, messages(path, Keyword.take(opts, [:time, :columns])), path, opts)
  end

  @doc """
  Returns the columns of a file, and the names and types of those that are left out because their types are not read.
  Of several columns of one name, the later ones are numbered: `x`, `x_1`. Errors: `:io`, `:not_parquet`.
  """
  @spec columns(Path.t()) ::
          {:ok, %{columns: [String.t()], left_out: [{name :: String.t(), type :: String.t()}]}}
          | {:error, Error.t()}
  def columns(path), do: Columnar.columns(File, path)

  @doc """
  The rows as a lazy enumerable of `{time, value}`. Memory is that of a page of each column that is wanted. Raises
  `Situ.Error`: `:io`, `:not_parquet`, `:no_column`.

  Options: `time:` and `columns:` as `read/3`; `notice:`, a function that gets a sentence about columns, and about rows,
  that are left out; by default it is logged as a warning.
  """
  @spec messages(Path.t(), keyword()) :: Enumerable.t()
  def messages(path, opts \\ []), do: Columnar.messages(File, path, opts)
end
