defmodule Situ.CLI.Store.StreamDetails do
  @moduledoc false
  # Prints all known properties of one stream.
  alias Situ.CLI.{DataFormat, Output}
  alias Situ.{Store, Time}
  alias Situ.Store.StreamInfo

  @not_real "not real time"

  @spec print_stream(Store.t(), String.t(), boolean()) :: :ok
  def print_stream(store, name, json?) do
    case Store.stream_info(store, name) do
      {:ok, info} when json? -> store |> stream_json(info) |> Output.print_json()
      {:ok, info} -> print_text(store, info)
      {:error, error} -> raise error
    end
  end

  defp print_text(store, info) do
    Output.puts("#{info.name}  (stream #{info.id} of #{store.path})")

    for {label, value} <- detail_rows(store, info),
        do: Output.puts("  #{String.pad_trailing(label, 12)}#{value}")

    :ok
  end

  defp detail_rows(store, info) do
    [
      {"type", format_type(info) <> field_list(info)},
      {"metadata", metadata_text(store, info)},
      {"opened", format_time(info.opened)},
      {"closed", closed_text(info)},
      {"messages", "#{info.count}, #{format_rate(info)}"},
      {"happened", format_interval(info.first, info.last)},
      {"created", format_interval(info.first_creation, info.last_creation)},
      {"size", size_text(store, info)},
      {"latency", total_latency(store, info)},
      {"stored", storage_text(store, info)}
    ]
  end

  defp field_list(%{fields: nil}), do: ""
  defp field_list(info), do: " (#{Enum.join(info.fields, ", ")})"

  defp metadata_text(_store, %{supplemental: nil}), do: "none"

  defp metadata_text(store, %{supplemental: {type, _}} = info) do
    case Store.metadata(store, info) do
      {:ok, term} -> "#{DataFormat.format_line(term)} (#{type})"
      {:error, _} -> "of type #{type}, which is not known on this machine"
    end
  end

  defp format_time(nil), do: "-"
  defp format_time(time), do: Time.to_iso8601(time)

  defp closed_text(%{closed: nil}), do: "no"
  defp closed_text(info), do: "at #{format_time(info.closed)}"

  defp format_interval(nil, _), do: "-"

  defp format_interval(from, to),
    do: "#{format_time(from)} .. #{format_time(to)}, #{Time.format_duration(to - from)}"

  defp size_text(store, info) do
    if value_known?(store, info, info.size) or value_known?(store, info, info.stored) do
      "#{format_bytes(store, info, info.size)}, #{format_bytes(store, info, StreamInfo.average_size(info))} each; " <>
        "#{format_bytes(store, info, info.stored)} on disk"
    else
      "unknown"
    end
  end

  defp total_latency(store, info) do
    case format_latency(store, info) do
      @not_real -> @not_real <> ": the messages were not created when they happened"
      "-" -> "unknown"
      average -> "#{average} on average, #{Time.format_duration(info.latency_sum)} in total"
    end
  end

  # External formats set unknown sizes and creation times to 0 or nil.
  defp value_known?(%{module: module}, _info, _value)
       when module in [Store.NativeFormat, Store.SegmentedRecording],
       do: true

  defp value_known?(_foreign, %{count: 0}, _value), do: true
  defp value_known?(_foreign, _info, value), do: value not in [nil, 0, 0.0]

  @doc "Returns whether the messages have times of creation. Most files of other programs have only one time."
  @spec latency_known?(Store.t(), StreamInfo.t()) :: boolean()
  def latency_known?(store, info),
    do: value_known?(store, info, StreamInfo.average_latency(info))

  @doc "Formats a size, or returns `-` if the format does not report it."
  @spec format_bytes(Store.t(), StreamInfo.t(), number() | nil) :: String.t()
  def format_bytes(store, info, size) do
    if value_known?(store, info, size), do: Output.format_bytes(round(size || 0)), else: "-"
  end

  defp nil_if_unknown(store, info, value), do: if(value_known?(store, info, value), do: value)

  defp storage_text(store, info) do
    lane = if info.large?, do: "each message separately", else: "in chunks"
    codecs = for {_, {name, _}} <- info.codecs, do: ", codec #{name}"
    "#{lane}, compression #{info.compression}#{codecs}#{video_text(store, info)}"
  end

  defp video_text(store, %{codecs: codecs} = info) do
    with true <- Enum.any?(codecs, &match?({_, {"situ.video_packet", _}}, &1)),
         {:ok, [%{data: packet}]} <- Store.read(store, info, limit: 1, packets: true) do
      ", #{packet.codec |> to_string() |> String.upcase()} video of #{packet.width}x#{packet.height}"
    else
      _ -> ""
    end
  end

  @doc "Returns the properties of a stream for JSON output. Unknown values are `nil`."
  @spec stream_json(Store.t(), StreamInfo.t()) :: map()
  def stream_json(store, info) do
    info
    |> Map.take([:id, :name, :store_name, :store_path, :count, :first, :last])
    |> Map.merge(Map.take(info, [:first_creation, :last_creation, :opened, :closed]))
    |> Map.merge(Map.take(info, [:compression, :fields]))
    |> Map.merge(%{
      size: nil_if_unknown(store, info, info.size),
      stored: nil_if_unknown(store, info, info.stored),
      latency_sum: nil_if_unknown(store, info, info.latency_sum),
      type: info.type_name,
      large: info.large?,
      codecs: for({_, {name, _}} <- info.codecs, do: name),
      metadata: metadata_json(info),
      rate: StreamInfo.message_rate(info),
      average_size: nil_if_unknown(store, info, StreamInfo.average_size(info)),
      average_latency: nil_if_unknown(store, info, StreamInfo.average_latency(info))
    })
  end

  defp metadata_json(%{supplemental: nil}), do: nil

  defp metadata_json(%{supplemental: {type, _}} = info) do
    case StreamInfo.metadata(info) do
      {:ok, term} -> term |> DataFormat.to_json() |> Map.put(:type, type)
      {:error, error} -> %{type: type, damage: error.why}
    end
  end

  @doc "Formats the type of a stream. Several possible types are joined by \"or\"."
  @spec format_type(StreamInfo.t()) :: String.t()
  def format_type(%{type: {:or, types}} = info) do
    if info.type_name == inspect(info.type),
      do: Enum.map_join(types, " or ", &inspect/1),
      else: info.type_name
  end

  def format_type(info), do: info.type_name

  @doc "Formats the number of messages per second."
  @spec format_rate(StreamInfo.t()) :: String.t()
  def format_rate(info) do
    case StreamInfo.message_rate(info) do
      nil -> "-"
      hz when hz >= 1_000 -> "#{Float.round(hz / 1_000, 2)} kHz"
      hz -> "#{Float.round(hz, 2)} Hz"
    end
  end

  @doc """
  Formats the average latency. It is meaningless if a replay ran at full speed, because its messages have creation times
  before their originating times.
  """
  @spec format_latency(Store.t(), StreamInfo.t()) :: String.t()
  def format_latency(store, info) do
    average = StreamInfo.average_latency(info)

    cond do
      average == nil or not latency_known?(store, info) -> "-"
      average < 0 -> @not_real
      true -> Time.format_duration(round(average))
    end
  end

  # Clocks that were never set start in 1970, and so do replays without a date.
  @first_real 946_684_800_000_000_000

  @doc "Returns whether a time can come from a clock that was set, which means that it is after 2000."
  @spec real_time?(Time.t()) :: boolean()
  def real_time?(time), do: time >= @first_real
end
