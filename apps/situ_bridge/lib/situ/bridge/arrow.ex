defmodule Situ.Bridge.Arrow do
  @export [
    streams: [
      type: {:optional, {:list, :string}},
      default: nil,
      doc: "The streams wanted; all by default."
    ],
    rows: [type: :pos_integer, default: 100_000, doc: "The most rows of a batch."]
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
  Recordings as Arrow files (IPC; also called Feather), which Polars, pandas and DuckDB map into memory as they are; and
  such files as streams.

      {:ok, counts} = Situ.Bridge.Arrow.export(store, "tables")        # tables/NAME.arrow, one a stream
      p |> Situ.Bridge.Arrow.read("levels.arrow") |> Situ.each(&IO.inspect/1)

  Rows and columns are those of `Situ.Bridge.Parquet`; such a file is larger, and faster to write and to read. Written
  are plain batches. Read are files and streams of Arrow: numbers, booleans, texts and bytes (their views too), times,
  dates, decimals, dictionaries of these, lists, maps and structs of all of them, also packed by LZ4 or zstd. Other
  columns (unions, list views, run-end encoded ones, intervals, dictionaries of lists or structs) are left out, and a
  warning names them; asking for one of them, or reading a file with no others, is an error.

  ## Options of `export/3`

  #{Situ.Options.docs(@export)}
  """
  alias Situ.Bridge.Arrow.{File, Writer}
  alias Situ.Bridge.Columnar
  alias Situ.{Error, Store}

  @doc """
  Writes streams of a recording into a folder, a file each: `{:ok, %{name => rows}}`. Streams without messages, and
  those of pictures, sound and the like, are left out. Errors: `:not_writable`, `:io`, `:disk_full`.
  """
  @spec export(Store.t(), Path.t(), keyword()) ::
          {:ok, %{String.t() => non_neg_integer()}} | {:error, Error.t()}
  def export(store, folder, opts \\ []) do
    opts = Situ.Options.validate!(opts, @export)
    Columnar.export(Writer, store, folder, ".arrow", opts)
  end

  @doc """
  Writes one stream of a recording into a file: `{:ok, rows}`. Options: `rows:` as `export/3`; `from:`, `to:`,
  `skip_damage:` as `Situ.Store.messages/3`; `progress:`, a function of the rows written so far.
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

      Situ.Bridge.Arrow.join(store, "drive.arrow", on: "Speed", streams: ["Pose"], within: Situ.Time.ms(50))

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
  A source of a file's rows; it proposes a replay from the first one on. Rows without a time, and those that are not
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
  Of several columns of one name, the later ones are numbered: `x`, `x_1`. Errors: `:io`, `:not_arrow`.
  """
  @spec columns(Path.t()) ::
          {:ok, %{columns: [String.t()], left_out: [{name :: String.t(), type :: String.t()}]}}
          | {:error, Error.t()}
  def columns(path), do: Columnar.columns(File, path)

  @doc """
  The rows as a lazy enumerable of `{time, value}`. Memory is that of some rows; of a packed batch, that of its columns
  that are wanted. Columns that are left out are logged. Raises `Situ.Error`: `:io`, `:not_arrow`, `:no_column`.

  Options: `time:` and `columns:` as `read/3`; `notice:`, a function that gets a sentence about columns, and about rows,
  that are left out; by default it is logged as a warning.
  """
  @spec messages(Path.t(), keyword()) :: Enumerable.t()
  def messages(path, opts \\ []), do: Columnar.messages(File, path, opts)
end
