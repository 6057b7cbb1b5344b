defmodule Situ.Bridge.Columnar do
  @moduledoc false
  # The shared part of Parquet and Arrow: writes messages as files of columns, and reads the rows of such files as
  # messages. The format is a writer (`Situ.Bridge.Columnar.Writer`) or a reader (`Situ.Bridge.Columnar.Reader`).
  # See docs/adr/0200-parquet-files-are-read-by-a-program.md.
  alias Situ.Bridge.Columnar.{Column, Join, NestedRows, Reader, Rows}
  alias Situ.{Error, Store}
  alias Situ.Columns
  require Logger

  @times [
    %Column{name: "originating_time", kind: :time, optional?: false},
    %Column{name: "creation_time", kind: :time, optional?: false}
  ]

  @doc "Writes streams of a recording into a folder, one file per stream, named after the stream and the extension."
  @spec export_streams(module(), Store.t(), Path.t(), extension :: String.t(), keyword()) ::
          {:ok, %{String.t() => non_neg_integer()}} | {:error, Error.t()}
  def export_streams(writer, store, folder, extension, opts) do
    {selection, opts} = Keyword.pop(opts, :streams)

    names =
      for info <- Store.streams(store),
          info.count > 0,
          selection == nil or info.name in selection,
          tabular_stream?(store, info),
          do: info.name

    with :ok <- create_folder(folder) do
      Enum.reduce_while(names, {:ok, %{}}, fn name, {:ok, counts} ->
        path = Path.join(folder, String.replace(name, ~r/[\/\x00-\x1f]/, "_") <> extension)

        case write_stream(writer, store, name, path, opts) do
          {:ok, rows} -> {:cont, {:ok, Map.put(counts, name, rows)}}
          error -> {:halt, error}
        end
      end)
    end
  end

  defp create_folder(folder) do
    with {:error, reason} <- Elixir.File.mkdir_p(folder),
         do:
           {:error,
            Error.new(:io, "cannot create #{folder}", why: to_string(:file.format_error(reason)))}
  end

  defp tabular_stream?(store, info) do
    case Store.at(store, info.name, 0) do
      {:ok, %{data: %module{}}} -> not Situ.Codec.implemented_by?(module)
      {:ok, _} -> true
      _ -> false
    end
  end

  @doc "Writes one stream of a recording. Takes the options of the format and of `Store.messages/3`, and `progress:`."
  @spec write_stream(module(), Store.t(), String.t(), Path.t(), keyword()) ::
          {:ok, non_neg_integer()} | {:error, Error.t()}
  def write_stream(writer, store, name, path, opts) do
    {read_opts, opts} = Keyword.split(opts, [:from, :to, :skip_damage])
    {progress, opts} = Keyword.pop(opts, :progress, fn _rows -> :ok end)

    # A live recording may receive messages of another kind during the export, so the export ends at the current end.
    parts = Store.columns(store, name, Keyword.put_new(read_opts, :to, last_time(store, name)))
    write_parts(writer, parts, path, opts, progress)
  rescue
    error in Error -> {:error, error}
  catch
    {:not_writable, what} -> not_writable_error(name, what)
  end

  @doc "Writes lists of messages into a file; enumerates them twice."
  @spec write_messages(module(), Enumerable.t(), Path.t(), keyword()) ::
          {:ok, non_neg_integer()} | {:error, Error.t()}
  def write_messages(writer, parts, path, opts) do
    write_parts(writer, parts, path, opts, fn _rows -> :ok end)
  rescue
    error in Error -> {:error, error}
  catch
    {:not_writable, what} -> not_writable_error("the messages", what)
  end

  @doc "Writes several streams of a recording as one table. Takes the options of a join and of `write_stream/5`."
  @spec write_joined(module(), Store.t(), Path.t(), keyword()) ::
          {:ok, non_neg_integer()} | {:error, Error.t()}
  def write_joined(writer, store, path, opts) do
    {join_opts, opts} = Keyword.split(opts, Keyword.keys(Join.join_options()))
    {read_opts, opts} = Keyword.split(opts, [:from, :to, :skip_damage])
    {progress, opts} = Keyword.pop(opts, :progress, fn _rows -> :ok end)
    on = join_opts[:on]
    read_opts = Keyword.put_new(read_opts, :to, last_time(store, on))

    parts =
      Join.stream_parts(
        store,
        on,
        other_streams(store, on, join_opts[:streams]),
        join_opts,
        read_opts
      )

    write_parts(writer, parts, path, opts, progress)
  rescue
    error in Error -> {:error, error}
  catch
    {:not_writable, what} -> not_writable_error("the table", what)
  end

  defp other_streams(store, on, nil) do
    for info <- Store.streams(store), info.name != on, tabular_stream?(store, info), do: info.name
  end

  defp other_streams(store, on, names) do
    for name <- Enum.uniq(names), name != on do
      case Store.stream_info(store, name) do
        {:ok, info} -> info.name
        {:error, error} -> raise error
      end
    end
  end

  defp not_writable_error(name, what) do
    {:error,
     Error.new(:not_writable, "#{name} cannot be written as a table", why: inspect(what, limit: 5))}
  end

  defp write_parts(format, parts, path, opts, progress) do
    rows = if opts[:nested], do: NestedRows, else: Rows
    columns = parts |> Enum.reduce(%{}, &rows.merge_part_kinds(&2, &1)) |> rows.build_columns()

    with {:ok, writer} <- format.create(path, @times ++ columns, opts) do
      try do
        parts
        |> row_groups({rows, columns}, format.max_rows(opts[:rows]))
        |> Enum.reduce_while({:ok, writer}, &write_group(format, &1, &2, progress))
      catch
        kind, reason ->
          format.abandon(writer)
          :erlang.raise(kind, reason, __STACKTRACE__)
      else
        result -> finish_file(result, format)
      end
    end
  end

  defp write_group(format, {values, rows}, {:ok, writer}, progress) do
    case format.write(writer, values, rows) do
      {:ok, writer} ->
        progress.(writer.rows)
        {:cont, {:ok, writer}}

      error ->
        {:halt, {error, writer}}
    end
  end

  defp last_time(store, name) do
    case Store.stream_info(store, name) do
      {:ok, info} -> info.last
      {:error, error} -> raise error
    end
  end

  # Returns groups of rows: rows or the values of each column, and the number of rows. Parts that are already columns
  # of numbers are passed on directly; other messages are collected until they fill a group.
  defp row_groups(parts, columns, max) do
    parts
    |> Stream.concat([:end])
    |> Stream.transform({[], 0}, fn
      :end, {buffer, _} ->
        {buffer |> concat_buffer() |> message_group(columns), {[], 0}}

      %Columns{} = part, {buffer, _} ->
        {message_group(concat_buffer(buffer), columns) ++ number_groups(part, columns, max),
         {[], 0}}

      messages, {buffer, n} ->
        buffer_messages([messages | buffer], n + length(messages), columns, max)
    end)
  end

  defp concat_buffer(buffer), do: buffer |> Enum.reverse() |> Enum.concat()

  defp buffer_messages(buffer, n, _columns, max) when n < max, do: {[], {buffer, n}}

  defp buffer_messages(buffer, n, columns, max) do
    {full, rest} = buffer |> concat_buffer() |> Enum.split(n - rem(n, max))
    groups = full |> Enum.chunk_every(max) |> Enum.flat_map(&message_group(&1, columns))
    {groups, {[rest], rem(n, max)}}
  end

  defp message_group([], _columns), do: []

  defp message_group(messages, {rows, columns}),
    do: [{{:rows, rows.build_rows(messages, columns)}, length(messages)}]

  defp number_groups(%{kind: kind} = part, {_rows, [%{name: "value", kind: kind}]}, max) do
    for columns <- Columns.split(part, max) do
      bytes = [columns.times, columns.creation_times, columns.values]
      {for(bytes <- bytes, do: {:bytes, bytes, columns.count}), columns.count}
    end
  end

  # The kind of the part's numbers differs from the kind of the column.
  defp number_groups(part, {rows, columns}, max) do
    for part <- Columns.split(part, max) do
      creations = for <<time::little-signed-64 <- part.creation_times>>, do: time

      list =
        Enum.zip_with(Columns.to_pairs(part), creations, fn {time, value}, creation ->
          [time, creation | rows.row_values(value, columns)]
        end)

      {{:rows, list}, part.count}
    end
  end

  defp finish_file({:ok, writer}, format), do: format.finish(writer)

  defp finish_file({error, writer}, format) do
    format.abandon(writer)
    error
  end

  @doc "Returns the columns of a file, and the columns that are skipped. Returns the errors of the format."
  @spec list_columns(module(), Path.t()) ::
          {:ok, %{columns: [String.t()], left_out: [{String.t(), String.t()}]}}
          | {:error, Error.t()}
  def list_columns(reader, path) do
    with {:ok, table} <- reader.open(path) do
      {:ok, %{columns: Enum.map(table.columns, & &1.name), left_out: table.left_out}}
    end
  end

  @doc """
  Returns the rows as a lazy enumerable of `{time, value}`, read a few at a time. Raises `Situ.Error`. Takes the
  options `time:`, `columns:`, `from:`, `to:`, and `notice:`, a function that receives a sentence about the skipped
  columns and a sentence about the skipped rows.
  """
  @spec stream_messages(module(), Path.t(), keyword()) :: Enumerable.t()
  def stream_messages(reader, path, opts) do
    table = reader.open(path) |> Error.unwrap!()
    time = fetch_time_column(table, opts[:time])
    selected = wanted_columns(table, opts[:columns], time)
    notice = opts[:notice] || fn sentence -> Logger.warning(sentence) end

    if opts[:columns] == nil and table.left_out != [],
      do: notice.("#{path}: skipped the columns #{list_left_out(table)}")

    range = {opts[:from], opts[:to]}
    names = Enum.map(selected, & &1.name)

    table
    |> reader.stream_rows(reader.select_groups(table, time, range), [time | selected])
    |> filter_times(range)
    |> Stream.transform(
      fn -> {nil, 0} end,
      &take_row(&1, &2, names),
      &report_rows(&1, path, notice),
      fn _state -> :ok end
    )
  end

  defp filter_times(rows, {nil, nil}), do: rows

  defp filter_times(rows, {from, to}) do
    Stream.filter(rows, fn [time | _values] ->
      not is_integer(time) or ((from == nil or time >= from) and (to == nil or time <= to))
    end)
  end

  defp take_row([time | values], {last, left_out}, names)
       when is_integer(time) and (last == nil or time > last),
       do: {[{time, row_value(names, values)}], {time, left_out}}

  defp take_row(_row, {last, left_out}, _names), do: {[], {last, left_out + 1}}

  defp report_rows({_last, left_out} = state, path, notice) do
    why = "they have no time, or it is not later than the time of the previous row"
    if left_out > 0, do: notice.("#{path}: skipped #{left_out} rows: #{why}")
    {[], state}
  end

  defp list_left_out(table),
    do: Enum.map_join(table.left_out, ", ", fn {name, type} -> "#{name} (#{type})" end)

  @spec fetch_time_column(Reader.t(), String.t() | nil) :: Reader.column()
  defp fetch_time_column(table, nil) do
    name = Enum.find(["originating_time" | table.times], &find_column(table, &1))

    if name,
      do: find_column(table, name),
      else: raise(no_column_error(table, "times", "name one with `time:`"))
  end

  defp fetch_time_column(table, name), do: fetch_column(table, name)

  defp find_column(table, name), do: Enum.find(table.columns, &(&1.name == name))

  defp fetch_column(table, name) do
    type = with {_name, type} <- List.keyfind(table.left_out, name, 0), do: type

    cond do
      column = find_column(table, name) ->
        column

      type ->
        raise no_column_error(
                table,
                "#{name} that can be read",
                "its type, #{type}, is not supported"
              )

      true ->
        raise no_column_error(table, inspect(name), nil)
    end
  end

  # All columns except the times. A file whose other columns are all unreadable is an error.
  defp wanted_columns(table, nil, time) do
    selected =
      Enum.reject(table.columns, &(&1.name in [time.name, "originating_time", "creation_time"]))

    if selected == [] and table.left_out != [],
      do: raise(no_column_error(table, "values that can be read", nil)),
      else: selected
  end

  defp wanted_columns(table, names, _time), do: Enum.map(names, &fetch_column(table, &1))

  defp no_column_error(table, what, fix) do
    left_out = if table.left_out != [], do: "; skipped: #{list_left_out(table)}"

    Error.new(:no_column, "#{table.path} has no column of #{what}",
      why: "its columns are #{Enum.map_join(table.columns, ", ", & &1.name)}#{left_out}",
      fix: fix
    )
  end

  defp row_value(["value"], [value]), do: value
  defp row_value(names, values), do: names |> :lists.zip(values) |> :maps.from_list()
end
