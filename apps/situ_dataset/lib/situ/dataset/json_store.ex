defmodule Situ.Dataset.JsonStore do
  @moduledoc false
  # Reads \psi's JSON stores as recordings. A store consists of `NAME.Catalog.json` (an array of
  # stream descriptions) and `NAME.Data.json` (an array of `{"Envelope": {"SourceId",
  # "SequenceId", "OriginatingTime", "Time"}, "Data": ...}` in the order of time).
  #
  #     {:ok, store} = Situ.Store.open("notes.Catalog.json")
  #
  # Data keeps its JSON form: maps with string keys, lists, numbers and strings. A message at the
  # left end of an interval is included (\psi's reader excludes it). Invalid messages, and
  # messages of streams that are not in the catalogue, are skipped and reported as damage.
  @behaviour Situ.Recording
  @behaviour Situ.Recording.Format

  alias Situ.{Error, Message, Time}
  alias Situ.Store.StreamInfo

  @largest 256 * 1024 * 1024
  @types %{
    "System.Double" => :float,
    "System.Single" => :float,
    "System.Int32" => :integer,
    "System.Int64" => :integer,
    "System.Boolean" => :boolean,
    "System.String" => :string
  }

  @enforce_keys [:name, :streams, :messages]
  defstruct [:name, :streams, :messages, damage: []]

  @impl true
  def extensions, do: [".json"]

  @impl true
  def kinds,
    do: [
      %Situ.Recording.FileKind{
        name: :json_store,
        title: "\\psi store in JSON",
        extensions: extensions(),
        open: __MODULE__
      }
    ]

  @impl true
  def open(path, _opts) do
    with {:ok, base} <- base_path(path),
         {:ok, catalog} <- read_array(base <> ".Catalog.json"),
         {:ok, data} <- read_array(base <> ".Data.json") do
      {messages, damage} = parse_messages(data, base <> ".Data.json")
      name = Path.basename(base)

      streams =
        for {%{} = entry, i} <- Enum.with_index(catalog),
            do: build_stream_info(entry, i, name, base)

      known = MapSet.new(streams, & &1.id)

      {grouped, strangers} =
        messages |> Enum.group_by(&elem(&1, 0), &elem(&1, 1)) |> Map.split(MapSet.to_list(known))

      lost = for {id, list} <- strangers, do: unknown_source_damage(base, id, length(list))

      {:ok,
       %__MODULE__{
         name: name,
         streams: Enum.map(streams, &put_counts(&1, grouped[&1.id] || [])),
         messages:
           Map.new(grouped, fn {id, list} -> {id, list |> sort_by_time() |> List.to_tuple()} end),
         damage: damage ++ lost
       }}
    end
  end

  defp base_path(path) do
    case Regex.run(~r/\A(.+)\.(Catalog|Data)\.json\z/s, path) do
      [_, base, _] ->
        {:ok, base}

      nil ->
        {:error,
         Error.new(:unknown_format, "#{path} is not a recording",
           why: "a JSON store consists of NAME.Catalog.json and NAME.Data.json",
           fix: "choose the catalogue; dataset files are opened with `situ dataset`"
         )}
    end
  end

  defp read_array(path) do
    with {:ok, %{size: size}} when size <= @largest <- File.stat(path),
         {:ok, text} <- File.read(path),
         {:ok, list} when is_list(list) <- text |> strip_bom() |> Situ.JSON.decode() do
      {:ok, list}
    else
      {:ok, %File.Stat{size: size}} ->
        {:error, damaged_error(path, "it has #{size} bytes; the limit is #{@largest}")}

      {:ok, _} ->
        {:error, damaged_error(path, "it is not an array")}

      {:error, :bad_json} ->
        {:error, damaged_error(path, "it is not complete JSON")}

      {:error, reason} ->
        {:error, damaged_error(path, to_string(:file.format_error(reason)))}
    end
  end

  # .NET sometimes writes a byte order mark.
  defp strip_bom(<<0xEF, 0xBB, 0xBF, text::binary>>), do: text
  defp strip_bom(text), do: text

  defp damaged_error(path, why) do
    Error.new(:damaged, "cannot read the JSON store file #{path}",
      why: why,
      fix: "restore the file"
    )
  end

  defp build_stream_info(entry, index, name, base) do
    type = string_or_nil(entry["TypeName"]) || "any"

    %StreamInfo{
      id: if(is_integer(entry["Id"]), do: entry["Id"], else: -1 - index),
      name: string_or_nil(entry["Name"]) || "Stream #{index}",
      store_name: name,
      store_path: Path.dirname(base),
      type_name: type,
      type: Map.get(@types, hd(String.split(type, ",")), :any),
      size:
        if(is_integer(entry["MessageSizeCumulativeSum"]),
          do: entry["MessageSizeCumulativeSum"],
          else: 0
        ),
      opened: parse_bound(entry["OpenedTime"], "0001-01-01"),
      closed: parse_bound(entry["ClosedTime"], "9999-12-31")
    }
  end

  defp string_or_nil(value), do: if(is_binary(value), do: value)

  # .NET writes its minimum and maximum time if a time is not set.
  defp parse_bound(value, none) do
    with text when is_binary(text) <- value,
         false <- String.starts_with?(text, none),
         {:ok, time} <- Time.parse(text) do
      time
    else
      _ -> nil
    end
  end

  defp put_counts(info, []), do: info

  defp put_counts(info, messages) do
    [first | _] = messages = sort_by_time(messages)
    last = List.last(messages)
    creations = Enum.map(messages, & &1.creation_time)

    %{
      info
      | count: length(messages),
        first: first.originating_time,
        last: last.originating_time,
        first_creation: Enum.min(creations),
        last_creation: Enum.max(creations),
        latency_sum: messages |> Enum.map(&Message.latency/1) |> Enum.sum(),
        closed: info.closed && max(info.closed, last.originating_time)
    }
  end

  defp sort_by_time(messages), do: Enum.sort_by(messages, & &1.originating_time)

  defp parse_messages(data, file) do
    {messages, broken} =
      data
      |> Enum.with_index()
      |> Enum.map(fn {entry, index} -> parse_message(entry) || index end)
      |> Enum.split_with(&is_tuple/1)

    {messages,
     for(
       index <- broken,
       do: %{file: file, offset: index, why: "entry #{index} is not a message"}
     )}
  end

  defp parse_message(%{"Envelope" => %{"SourceId" => id, "SequenceId" => n} = envelope} = entry)
       when is_integer(id) and is_integer(n) do
    with %{"OriginatingTime" => at, "Time" => made} when is_binary(at) and is_binary(made) <-
           envelope,
         {:ok, at} <- Time.parse(at),
         {:ok, made} <- Time.parse(made) do
      {id,
       %Message{
         data: entry["Data"],
         originating_time: at,
         creation_time: made,
         sequence_id: n,
         source_id: id
       }}
    else
      _ -> nil
    end
  end

  defp parse_message(_), do: nil

  defp unknown_source_damage(base, id, n),
    do: %{
      file: base <> ".Data.json",
      offset: 0,
      why: "#{n} messages of source #{id}, which is not in the catalogue"
    }

  @impl true
  def info(state),
    do: %{name: state.name, created: nil, closed?: true, live?: false, damage: state.damage}

  @impl true
  def streams(state), do: state.streams

  @impl true
  def seek(state, info, time) do
    messages = Map.get(state.messages, info.id, {})
    {:ok, find_first(messages, time, 0, tuple_size(messages))}
  end

  defp find_first(_messages, _time, low, low), do: low

  defp find_first(messages, time, low, high) do
    middle = div(low + high, 2)

    if elem(messages, middle).originating_time < time,
      do: find_first(messages, time, middle + 1, high),
      else: find_first(messages, time, low, middle)
  end

  @impl true
  def read(state, info, ordinal, to, limit, _opts) do
    messages = Map.get(state.messages, info.id, {})
    last = min(ordinal + limit, tuple_size(messages)) - 1

    page =
      for i <- ordinal..last//1,
          message = elem(messages, i),
          to == :unbounded or message.originating_time <= to,
          do: message

    {:ok, page, ordinal + length(page)}
  end
end
