defmodule Situ.Bridge.TableRecording do
  @moduledoc false
  # Opens tables (Parquet, Arrow, JSON lines, MessagePack) as recordings of one stream, so that they can be looked at
  # without an import. A table has no index of times, so it is read into memory; larger files have to be imported.
  @behaviour Situ.Recording
  @behaviour Situ.Recording.Format
  alias Situ.Bridge.{TableImport, TableKinds}
  alias Situ.{Error, Message}
  alias Situ.Store.StreamInfo

  @max_bytes 256 * 1024 * 1024

  defstruct [:path, :name, :times, :values, notes: []]

  # The functions of `TableKinds` call none of this module, which they only name.
  @impl true
  def extensions do
    for %{open: __MODULE__, extensions: extensions} <- TableKinds.kinds(),
        extension <- extensions,
        do: extension
  end

  @impl true
  def kinds, do: []

  @impl true
  def open(path, _opts) do
    with :ok <- check_size(path), {:ok, rows, notes} <- read_rows(path) do
      {times, values} = rows |> move_apart() |> Enum.unzip()

      {:ok,
       %__MODULE__{
         path: path,
         name: TableImport.stream_name(path),
         times: List.to_tuple(times),
         values: List.to_tuple(values),
         notes: notes
       }}
    end
  end

  defp check_size(path) do
    case File.stat(path) do
      {:ok, %{size: size}} when size <= @max_bytes ->
        :ok

      {:ok, %{size: size}} ->
        {:error,
         Error.new(:too_large, "#{path} is too large to be opened as a recording",
           why:
             "it has #{size} bytes, and a table of more than #{@max_bytes} is not read into memory",
           fix: "import it: `situ store import '#{path}' NAME`"
         )}

      {:error, reason} ->
        {:error,
         Error.new(:io, "cannot read #{path}", why: to_string(:file.format_error(reason)))}
    end
  end

  defp read_rows(path) do
    owner = self()
    ref = make_ref()
    notice = fn sentence -> send(owner, {ref, sentence}) end
    rows = path |> TableImport.read_table(notice) |> Enum.sort_by(&elem(&1, 0))
    {:ok, rows, collect_notices(ref)}
  rescue
    error in Error -> {:error, error}
  end

  defp collect_notices(ref) do
    receive do
      {^ref, sentence} -> [sentence | collect_notices(ref)]
    after
      0 -> []
    end
  end

  # The times of a stream increase.
  defp move_apart(rows) do
    {rows, _last} =
      Enum.map_reduce(rows, nil, fn {time, value}, last ->
        time = if last, do: max(time, last + 1), else: time
        {{time, value}, time}
      end)

    rows
  end

  @impl true
  def info(table),
    do: %{
      name: table.name,
      created: time_at(table, 0),
      closed?: true,
      live?: false,
      damage: [],
      notes: table.notes
    }

  @impl true
  def streams(table) do
    count = tuple_size(table.times)
    {first, last} = {time_at(table, 0), time_at(table, count - 1)}

    [
      %StreamInfo{
        id: 1,
        name: table.name,
        store_name: table.name,
        store_path: table.path,
        type: :any,
        type_name: "any",
        opened: first,
        closed: last || 0,
        count: count,
        first: first,
        last: last,
        first_creation: first,
        last_creation: last
      }
    ]
  end

  defp time_at(%{times: times}, n),
    do: if(n in 0..(tuple_size(times) - 1)//1, do: elem(times, n))

  @impl true
  def seek(table, _info, time),
    do: {:ok, search_time(table.times, time, 0, tuple_size(table.times))}

  defp search_time(_times, _time, low, high) when low >= high, do: low

  defp search_time(times, time, low, high) do
    middle = div(low + high, 2)

    if elem(times, middle) < time,
      do: search_time(times, time, middle + 1, high),
      else: search_time(times, time, low, middle)
  end

  @impl true
  def read(table, _info, ordinal, to, limit, _opts) do
    last = min(tuple_size(table.times), ordinal + limit) - 1

    messages =
      for n <- ordinal..last//1,
          time = elem(table.times, n),
          to == :unbounded or time <= to do
        %Message{
          data: elem(table.values, n),
          originating_time: time,
          creation_time: time,
          sequence_id: n + 1,
          source_id: 1
        }
      end

    {:ok, messages, ordinal + length(messages)}
  end
end
