defmodule Situ.Media.Capture.StallWatch do
  @moduledoc false
  # Checks for each stream of a sender whether its frames still arrive and whether their times still increase.
  # The reader only detects a sender that sends nothing at all.

  defstruct [:timeout, streams: %{}]

  @typep seen :: %{arrived: Situ.Time.t(), moved: Situ.Time.t(), time: Situ.Time.t() | nil}
  @type t :: %__MODULE__{timeout: pos_integer(), streams: %{atom() => seen()}}

  # Times that increase by less than this fraction of the timeout are stuck, because ffmpeg's muxer then adds one tick
  # per frame.
  @fraction 10

  @spec new([atom()], pos_integer(), Situ.Time.t()) :: t()
  def new(kinds, timeout, now) do
    streams = Map.new(kinds, &{&1, %{arrived: now, moved: now, time: nil}})
    %__MODULE__{timeout: timeout, streams: streams}
  end

  @doc "Records that a frame arrived at `now`. `time` is its originating time, or `nil` if it has none yet."
  @spec note_frame(t(), atom(), Situ.Time.t() | nil, Situ.Time.t()) :: t()
  def note_frame(%__MODULE__{} = watch, kind, time, now) do
    seen = %{Map.fetch!(watch.streams, kind) | arrived: now}

    moved =
      cond do
        time == nil -> %{seen | moved: now}
        seen.time && time - seen.time < div(watch.timeout, @fraction) -> seen
        true -> %{seen | time: time, moved: now}
      end

    %{watch | streams: Map.put(watch.streams, kind, moved)}
  end

  @doc "Returns the streams without a frame for longer than the timeout, and the streams whose times are stuck."
  @spec find_stalls(t(), Situ.Time.t()) :: %{silent: [atom()], stuck: [atom()]}
  def find_stalls(%__MODULE__{timeout: timeout} = watch, now) do
    {silent, heard} =
      Enum.split_with(watch.streams, fn {_, seen} -> now - seen.arrived > timeout end)

    stuck = for {kind, seen} <- heard, now - seen.moved > timeout, do: kind
    %{silent: Keyword.keys(silent), stuck: stuck}
  end
end
