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

  Read are columns that are not nested, plain or packed by Snappy, gzip or zstd, by the encodings PLAIN, dictionary,
  RLE and DELTA_BINARY_PACKED; another one is an error that names it. A row is a map of its columns, or of the one
  column `value` the value.

  ## Options of `export/3`

  #{Situ.Options.docs(@export)}
  """
  alias Situ.Bridge.Parquet.{Column, File, Rows, Writer}
  alias Situ.{Error, Store}
  alias Situ.Store.Columns

  @times [
    %Column{name: "originating_time", kind: :time, optional?: false},
    %Column{name: "creation_time", kind: :time, optional?: false}
  ]

  @doc """
  Writes streams of a recording into a folder, a file each: `{:ok, %{name => rows}}`. Streams without messages, and
  those of pictures, sound and the like, are left out. Errors: `:not_writable`, `:io`, `:disk_full`.
  """
  @spec export(Store.t(), Path.t(), keyword()) ::
          {:ok, %{String.t() => non_neg_integer()}} | {:error, Error.t()}
  def export(store, folder, opts \\ []) do
    opts = Situ.Options.validate!(opts, @export)

    names =
      for info <- Store.streams(store),
          info.count > 0,
          opts[:streams] == nil or info.name in opts[:streams],
          table?(store, info),
          do: info.name

    with :ok <- mkdir(folder) do
      Enum.reduce_while(names, {:ok, %{}}, fn name, {:ok, counts} ->
        case write(
               store,
               name,
               Path.join(folder, file_name(name)),
               Keyword.delete(opts, :streams)
             ) do
          {:ok, rows} -> {:cont, {:ok, Map.put(counts, name, rows)}}
          error -> {:halt, error}
        end
      end)
    end
  end

  defp mkdir(folder) do
    with {:error, reason} <- Elixir.File.mkdir_p(folder),
         do:
           {:error,
            Error.new(:io, "cannot make #{folder}", why: to_string(:file.format_error(reason)))}
  end

  @doc false
  def file_name(name), do: String.replace(name, ~r/[\/\x00-\x1f]/, "_") <> ".parquet"

  defp table?(store, info) do
    case Store.at(store, info.name, 0) do
      {:ok, %{data: %module{}}} -> not Situ.Codec.implemented_by?(module)
      {:ok, _} -> true
      _ -> false
    end
  end

  @doc """
  Writes one stream of a recording into a file: `{:ok, rows}`. Options: `compression:` and `rows:` as `export/3`;
  `from:`, `to:`, `skip_damage:` as `Situ.Store.messages/3`; `progress:`, a function of the rows written so far.
  """
  @spec write(Store.t(), String.t(), Path.t(), keyword()) ::
          {:ok, non_neg_integer()} | {:error, Error.t()}
  def write(store, name, path, opts \\ []) do
    {reading, opts} = Keyword.split(opts, [:from, :to, :skip_damage])
    {progress, opts} = Keyword.pop(opts, :progress, fn _rows -> :ok end)
    opts = Situ.Options.validate!(opts, Keyword.delete(@export, :streams))

    # Messages that a live recording adds meanwhile may be of another kind, so the export ends at the last one now.
    parts = Store.columns(store, name, Keyword.put_new(reading, :to, last(store, name)))
    write_parts(parts, path, opts, progress)
  rescue
    error in Error -> {:error, error}
  catch
    {:not_writable, what} -> not_writable(name, what)
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
    write_parts(parts, path, opts, fn _rows -> :ok end)
  rescue
    error in Error -> {:error, error}
  catch
    {:not_writable, what} -> not_writable("the messages", what)
  end

  defp not_writable(name, what) do
    {:error, Error.new(:not_writable, "#{name} cannot be a table", why: inspect(what, limit: 5))}
  end

  defp write_parts(parts, path, opts, progress) do
    columns = parts |> Enum.reduce(%{}, &Rows.part(&2, &1)) |> Rows.columns()

    with {:ok, writer} <- Writer.create(path, @times ++ columns, opts[:compression]) do
      parts
      |> groups(columns, opts[:rows])
      |> Enum.reduce_while({:ok, writer}, fn {values, rows}, {:ok, writer} ->
        case Writer.write(writer, values, rows) do
          {:ok, writer} ->
            progress.(writer.rows)
            {:cont, {:ok, writer}}

          error ->
            {:halt, {error, writer}}
        end
      end)
      |> finished()
    end
  end

  defp last(store, name) do
    case Store.stream_info(store, name) do
      {:ok, info} -> info.last
      {:error, error} -> raise error
    end
  end

  # Row groups: the values of each column, and how many rows. Numbers come as they are, others gather until there are
  # enough for a group.
  defp groups(parts, columns, most) do
    parts
    |> Stream.concat([:end])
    |> Stream.transform({[], 0}, fn
      :end, {held, _} ->
        {held |> together() |> group(columns), {[], 0}}

      %Columns{} = part, {held, _} ->
        {group(together(held), columns) ++ plain(part, columns, most), {[], 0}}

      messages, {held, n} ->
        gathered([messages | held], n + length(messages), columns, most)
    end)
  end

  defp together(held), do: held |> Enum.reverse() |> Enum.concat()

  defp gathered(held, n, _columns, most) when n < most, do: {[], {held, n}}

  defp gathered(held, n, columns, most) do
    {full, rest} = held |> together() |> Enum.split(n - rem(n, most))
    groups = full |> Enum.chunk_every(most) |> Enum.flat_map(&group(&1, columns))
    {groups, {[rest], rem(n, most)}}
  end

  defp group([], _columns), do: []
  defp group(messages, columns), do: [{values(messages, columns), length(messages)}]

  defp plain(%{kind: kind} = part, [%{name: "value", kind: kind}], most) do
    for columns <- Columns.split(part, most) do
      bytes = [columns.times, columns.creation_times, columns.values]
      {for(bytes <- bytes, do: {:bytes, bytes, columns.count}), columns.count}
    end
  end

  # Numbers of one kind in a column of another.
  defp plain(part, columns, most) do
    for part <- Columns.split(part, most) do
      creations = for <<time::little-signed-64 <- part.creation_times>>, do: time
      {times, values} = part |> Columns.pairs() |> Enum.unzip()
      rows = Enum.zip_with(Enum.map(values, &Rows.row(&1, columns)), & &1)
      {[times, creations | rows], part.count}
    end
  end

  defp finished({:ok, writer}), do: Writer.finish(writer)

  defp finished({error, writer}) do
    Writer.abandon(writer)
    error
  end

  # A single column of plain values is by far the most frequent one.
  defp values(messages, columns) do
    rows = for m <- messages, do: Rows.row(m.data, columns)
    times = [Enum.map(messages, & &1.originating_time), Enum.map(messages, & &1.creation_time)]
    times ++ if(columns == [], do: [], else: Enum.zip_with(rows, & &1))
  end

  @doc """
  A source of a table's rows; it proposes a replay from the first one on. Rows without a time, and those that are not
  later than the one before, are left out.

  #{Situ.Options.docs(@read)}
  """
  @spec read(Situ.Pipeline.t(), Path.t(), keyword()) :: Situ.Stream.t()
  def read(p, path, opts \\ []) do
    opts = Situ.Options.validate!(opts, @read)
    messages = messages(path, Keyword.take(opts, [:time, :columns]))

    case Enum.take(messages, 1) do
      [{first, _}] ->
        Situ.from_enumerable(p, messages, [start: first] ++ Keyword.take(opts, [:type, :name]))

      [] ->
        raise Error.new(:empty_file, "there is no row with a time in #{path}")
    end
  end

  @doc """
  The rows as a lazy enumerable of `{time, value}`, read by row group. Raises `Situ.Error`: `:io`, `:not_parquet`,
  `:no_column`.
  """
  @spec messages(Path.t(), keyword()) :: Enumerable.t()
  def messages(path, opts \\ []) do
    parquet = Error.unwrap!(File.open(path))
    time = time(parquet, opts[:time])
    wanted = wanted(parquet, opts[:columns], time)

    parquet.groups
    |> Stream.flat_map(fn group ->
      parquet |> File.rows(group, [time | wanted]) |> Error.unwrap!()
    end)
    |> Stream.transform(nil, fn
      [time | values], last when is_integer(time) and (last == nil or time > last) ->
        {[{time, value(wanted, values)}], time}

      _row, last ->
        {[], last}
    end)
  end

  defp time(parquet, nil) do
    found = Enum.find(["originating_time" | parquet.times], &column(parquet, &1))

    if found,
      do: column(parquet, found),
      else: raise(no_column(parquet, "times; name one by `time:`"))
  end

  defp time(parquet, name), do: column(parquet, name) || raise(no_column(parquet, inspect(name)))

  defp column(parquet, name), do: Enum.find(parquet.columns, &(&1.name == name))

  defp wanted(parquet, nil, time),
    do:
      Enum.reject(parquet.columns, &(&1.name in [time.name, "originating_time", "creation_time"]))

  defp wanted(parquet, names, _time),
    do: for(name <- names, do: column(parquet, name) || raise(no_column(parquet, inspect(name))))

  defp no_column(parquet, what) do
    Error.new(:no_column, "#{parquet.path} has no column of #{what}",
      why: "its columns are #{Enum.map_join(parquet.columns, ", ", & &1.name)}"
    )
  end

  defp value([%{name: "value"}], [value]), do: value
  defp value(columns, values), do: columns |> Enum.zip_with(values, &{&1.name, &2}) |> Map.new()
end
