defmodule Situ.Studio.Layout.SignalRange do
  @moduledoc false
  # Estimates the range of the values of numeric streams from a few messages, so that the automatic layout draws only
  # streams of similar magnitude on one axis.
  alias Situ.Store
  alias Situ.Studio.{StreamInfo, StreamReader}

  @typedoc "The minimum and maximum."
  @type t :: {number(), number()}

  # The maximum number of streams to examine, and the number of messages of each.
  @most 40
  @sample 24
  # On one axis, the smallest range has at least this share of the whole.
  @share 0.1

  @doc "Estimates the ranges of a source's numeric streams, by stream name. Streams that cannot be read are left out."
  @spec detect_ranges(Situ.Recording.t(), [StreamInfo.t()]) :: %{optional(String.t()) => t()}
  def detect_ranges(source, streams) do
    signals = for %{shape: :signal, first: first} = s <- streams, first != nil, do: s

    for %StreamInfo{name: name} = stream <- Enum.take(signals, @most),
        {:ok, info} <- [Store.stream_info(source, name)],
        {:ok, sample} <-
          [StreamReader.sample_messages(source, info, stream.first, stream.last, @sample)],
        [_ | _] = numbers <- [for({_, %{data: x}} <- sample, is_number(x), do: x)],
        into: %{},
        do: {name, Enum.min_max(numbers)}
  end

  @doc """
  Groups streams so that the streams of a group have similar ranges. Keeps the order of the first stream of each group.
  Streams without a known range are in one group.

      iex> ranges = %{"Angle" => {-1.0, 1.0}, "Torque" => {0, 1.0e12}, "Tilt" => {-0.5, 0.7}}
      iex> Situ.Studio.Layout.SignalRange.group_similar(["Angle", "Torque", "Tilt"], ranges, & &1)
      [["Angle", "Tilt"], ["Torque"]]
  """
  @spec group_similar([stream], %{optional(String.t()) => t()}, (stream -> String.t())) :: [
          [stream]
        ]
        when stream: term()
  def group_similar(streams, ranges, name_of) do
    Enum.reduce(streams, [], fn stream, groups ->
      range = ranges[name_of.(stream)]

      case Enum.find_index(groups, fn {members, _} -> similar_range?(range, members) end) do
        nil -> groups ++ [{List.wrap(range), [stream]}]
        i -> List.update_at(groups, i, fn {r, s} -> {List.wrap(range) ++ r, s ++ [stream]} end)
      end
    end)
    |> Enum.map(&elem(&1, 1))
  end

  defp similar_range?(nil, members), do: members == []

  defp similar_range?(range, members) do
    all = [range | members]
    {lows, highs} = Enum.unzip(all)
    whole = Enum.max(highs) - Enum.min(lows)
    members != [] and Enum.all?(all, fn {low, high} -> high - low >= @share * whole end)
  end
end
