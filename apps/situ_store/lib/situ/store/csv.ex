defmodule Situ.Store.Csv do
  @moduledoc false
  # Reads CSV files as recordings. `Situ.Store.open/2` documents the options.
  #
  # Files of any size are supported. Opening scans the file once and keeps only the position of
  # every 1,000th row, where later reads start. Copying into a store (`Situ.Store.copy/3`) reads
  # all columns in one further pass.
  @behaviour Situ.Recording
  @behaviour Situ.Recording.Format
  alias Situ.{Error, Message}
  alias Situ.Store.Csv.{ColumnCopy, Scan}
  alias Situ.Store.StreamInfo

  defstruct [:path, :size, :scan, :streams, :parts]

  @impl true
  def extensions, do: [".csv", ".tsv"]

  @impl true
  def kinds,
    do: [
      %Situ.Recording.FileKind{
        name: :csv,
        title: "CSV and TSV",
        extensions: extensions(),
        open: __MODULE__
      }
    ]

  @impl true
  def open(path, opts) do
    with {:ok, %{type: :regular, size: size}} <- File.stat(path),
         {:ok, scan} <- Scan.scan_file(path, opts) do
      streams =
        for {index, column} <- Enum.sort(scan.columns), do: build_stream_info(index, column, path)

      parts = scan.parts |> Enum.reverse() |> List.to_tuple()
      {:ok, %__MODULE__{path: path, size: size, scan: scan, streams: streams, parts: parts}}
    else
      {:ok, %{type: type}} ->
        {:error, Error.new(:io, "cannot read #{path}", why: "it is a #{type}, not a file")}

      {:error, reason} when is_atom(reason) ->
        {:error,
         Error.new(:io, "cannot read #{path}", why: to_string(:file.format_error(reason)))}

      {:error, why} ->
        {:error, Error.new(:not_csv, "#{path} is not a CSV file that Situ can read", why: why)}
    end
  end

  defp build_stream_info(index, column, path) do
    type = column.kind || :any

    %StreamInfo{
      id: index + 1,
      name: if(column.name == "", do: "Column#{index}", else: column.name),
      store_name: Path.basename(path, Path.extname(path)),
      store_path: path,
      type: type,
      type_name: inspect(type),
      count: column.count,
      first: column.first,
      last: column.last,
      first_creation: column.first,
      last_creation: column.last,
      closed: column.last
    }
  end

  @impl true
  def info(state) do
    name = Path.basename(state.path, Path.extname(state.path))
    damage = Enum.reverse(state.scan.damage)
    %{name: name, created: nil, closed?: true, live?: false, damage: damage}
  end

  @impl true
  def streams(state), do: state.streams

  @impl true
  def seek(state, info, time) do
    at = first_part(state, time)

    with {:ok, messages} <- part_messages(state, info, at) do
      before = Enum.count(messages, &(&1.originating_time < time))
      {:ok, count_messages_before(state, info, at) + before}
    end
  end

  @impl true
  def read(state, info, ordinal, to, limit, opts) do
    if ordinal >= info.count,
      do: {:ok, [], ordinal},
      else: read_part(state, info, ordinal, to, if(opts[:exact], do: limit, else: :all))
  end

  @impl true
  def append_streams(state, targets, {from, _to} = interval, report_progress) do
    # A column without fields has no kind and no messages.
    filled = for {%{count: count}, _stream} = target <- targets, count > 0, do: target

    job = %ColumnCopy{
      scan: state.scan,
      parts: state.parts,
      targets: filled,
      interval: interval,
      messages: &part_messages(state, &1, &2),
      report_progress: report_progress
    }

    with {:error, why} when is_binary(why) <-
           ColumnCopy.append_parts(job, first_part(state, from)),
         do: {:error, changed_error(state, why)}
  end

  # Returns the rest of the part that contains the message, because parts are always read completely.
  defp read_part(state, info, ordinal, to, most) do
    at = find_last_part(state.parts, &(Map.get(&1.counts, info.id - 1, 0) <= ordinal))

    with {:ok, messages} <- part_messages(state, info, at) do
      case Enum.drop(messages, ordinal - count_messages_before(state, info, at)) do
        [] ->
          {:error, changed_error(state)}

        messages ->
          messages = if most == :all, do: messages, else: Enum.take(messages, most)

          messages =
            if to == :unbounded,
              do: messages,
              else: Enum.take_while(messages, &(&1.originating_time <= to))

          {:ok, messages, ordinal + length(messages)}
      end
    end
  end

  # Finds the last part that begins before `time`. The requested message is in this part or is the first one after it.
  defp first_part(state, time),
    do: find_last_part(state.parts, &(&1.last == nil or &1.last < time))

  defp changed_error(state, why \\ nil),
    do: Error.new(:damaged, "#{state.path} has changed since it was opened", why: why)

  # Finds the last part for which `before?` is true. It must be true for a prefix of the parts and false for the rest.
  defp find_last_part(parts, before?), do: find_last_part(parts, before?, 0, tuple_size(parts))
  defp find_last_part(_parts, _before?, low, high) when high - low <= 1, do: low

  defp find_last_part(parts, before?, low, high) do
    middle = div(low + high, 2)

    if before?.(elem(parts, middle)),
      do: find_last_part(parts, before?, middle, high),
      else: find_last_part(parts, before?, low, middle)
  end

  defp count_messages_before(%{parts: {}}, _info, _at), do: 0

  defp count_messages_before(state, info, at),
    do: Map.get(elem(state.parts, at).counts, info.id - 1, 0)

  defp part_messages(%{parts: {}}, _info, _at), do: {:ok, []}

  defp part_messages(state, info, at) do
    part = elem(state.parts, at)

    case Scan.read_values(state.scan, part, info.id - 1) do
      {:ok, values} ->
        {:ok, build_messages(values, info.id, (part.counts[info.id - 1] || 0) + 1)}

      {:error, why} ->
        {:error, changed_error(state, why)}
    end
  end

  defp build_messages([], _source, _sequence), do: []

  defp build_messages([{time, value} | values], source, sequence) do
    message = %Message{
      data: value,
      originating_time: time,
      creation_time: time,
      sequence_id: sequence,
      source_id: source
    }

    [message | build_messages(values, source, sequence + 1)]
  end
end
