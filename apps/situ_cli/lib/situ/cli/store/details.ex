defmodule Situ.CLI.Store.Details do
  @moduledoc false
  # Everything that is known of one stream.
  alias Situ.CLI.{Data, Output}
  alias Situ.{Store, Time}
  alias Situ.Store.StreamInfo

  @spec print(Store.Handle.t(), String.t(), boolean()) :: :ok
  def print(store, name, json?) do
    case Store.stream_info(store, name) do
      {:ok, info} when json? -> info |> json() |> Output.json()
      {:ok, info} -> text(store, info)
      {:error, error} -> raise error
    end
  end

  defp text(store, info) do
    Output.puts("#{info.name}  (stream #{info.id} of #{store.path})")

    for {label, value} <- rows(store, info),
        do: Output.puts("  #{String.pad_trailing(label, 12)}#{value}")

    :ok
  end

  defp rows(store, info) do
    [
      {"type", info.type_name <> fields(info)},
      {"metadata", supplemental(store, info)},
      {"opened", time(info.opened)},
      {"closed", closed(info)},
      {"messages", "#{info.count}, #{rate(info)}"},
      {"happened", span(info.first, info.last)},
      {"created", span(info.first_creation, info.last_creation)},
      {"size",
       "#{Output.bytes(info.size)}, #{average(info)} each; #{Output.bytes(info.stored)} on disk"},
      {"latency",
       "#{latency(info)} on average, #{Time.format_duration(info.latency_sum)} in all"},
      {"stored", stored(info)}
    ]
  end

  defp fields(%{fields: nil}), do: ""
  defp fields(info), do: " (#{Enum.join(info.fields, ", ")})"

  defp supplemental(_store, %{supplemental: nil}), do: "none"

  defp supplemental(store, %{supplemental: {type, _}} = info) do
    case Store.metadata(store, info) do
      {:ok, term} -> "#{Data.text(term)} (#{type})"
      {:error, _} -> "of type #{type}, which is not known here"
    end
  end

  defp time(nil), do: "-"
  defp time(time), do: Time.to_iso8601(time)

  defp closed(%{closed: nil}), do: "no"
  defp closed(info), do: "at #{time(info.closed)}"

  defp span(nil, _), do: "-"
  defp span(from, to), do: "#{time(from)} .. #{time(to)}, #{Time.format_duration(to - from)}"

  defp average(info), do: Output.bytes(round(StreamInfo.average_size(info) || 0))

  defp stored(info) do
    lane = if info.large?, do: "each message by itself", else: "in chunks"
    codecs = for {_, {name, _}} <- info.codecs, do: ", codec #{name}"
    "#{lane}, compression #{info.compression}#{codecs}"
  end

  @doc "For programs."
  @spec json(StreamInfo.t()) :: map()
  def json(info) do
    info
    |> Map.take([:id, :name, :store_name, :store_path, :count, :size, :stored, :first, :last])
    |> Map.merge(Map.take(info, [:first_creation, :last_creation, :opened, :closed]))
    |> Map.merge(Map.take(info, [:compression, :latency_sum, :fields]))
    |> Map.merge(%{
      type: info.type_name,
      large: info.large?,
      codecs: for({_, {name, _}} <- info.codecs, do: name),
      metadata: metadata(info),
      rate: StreamInfo.rate(info),
      average_size: StreamInfo.average_size(info),
      average_latency: StreamInfo.average_latency(info)
    })
  end

  defp metadata(%{supplemental: nil}), do: nil

  defp metadata(%{supplemental: {type, _}} = info) do
    case StreamInfo.metadata(info) do
      {:ok, term} -> term |> Data.json() |> Map.put(:type, type)
      {:error, error} -> %{type: type, damage: error.why}
    end
  end

  @doc "Messages a second."
  @spec rate(StreamInfo.t()) :: String.t()
  def rate(info) do
    case StreamInfo.rate(info) do
      nil -> "-"
      hz when hz >= 1_000 -> "#{Float.round(hz / 1_000, 2)} kHz"
      hz -> "#{Float.round(hz, 2)} Hz"
    end
  end

  @doc "The average latency."
  @spec latency(StreamInfo.t()) :: String.t()
  def latency(info) do
    case StreamInfo.average_latency(info) do
      nil -> "-"
      ns -> Time.format_duration(round(ns))
    end
  end
end
