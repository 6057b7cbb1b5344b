defmodule Situ.Studio.Figures do
  @moduledoc """
  Statistics next to the names in the trees of streams, recordings and sessions, for one or several streams.

      iex> alias Situ.Studio.{Figures, StreamInfo}
      iex> s = 1_000_000_000
      iex> level = %StreamInfo{name: "A", shape: :signal, count: 101, bytes: 808, latency: 2.0e6, first: 0, last: s}
      iex> image = %StreamInfo{name: "Image", shape: :image, count: 1, bytes: 192, latency: 4.0e6, first: 0, last: 0}
      iex> both = Figures.sum([level, image])
      iex> for choice <- [:count, :size, :average_size, :bytes_per_second, :rate, :streams, :duration],
      ...>     do: Figures.text(choice, both)
      ["102", "1.0 kB", "9.8 B", "1.0 kB/s", "101/s", "2 streams", "1.00 s"]
      iex> Figures.text(:latency, both)
      "2.02 ms"
  """
  alias Situ.Studio.StreamInfo

  # Several sessions may overlap or be days apart, so their `length` is the sum of their durations.
  defstruct streams: 0,
            count: 0,
            bytes: 0,
            from: nil,
            to: nil,
            length: nil,
            rate: nil,
            latency: nil

  @type t :: %__MODULE__{
          streams: non_neg_integer(),
          count: non_neg_integer(),
          bytes: non_neg_integer(),
          from: Situ.Time.t() | nil,
          to: Situ.Time.t() | nil,
          length: Situ.Time.duration() | nil,
          rate: float() | nil,
          latency: number() | nil
        }

  @choices [
    none: "nothing",
    rate: "messages per second",
    per_minute: "messages per minute",
    per_hour: "messages per hour",
    count: "number of messages",
    duration: "duration",
    span: "time from the first message to the last",
    began: "date and time of the first message",
    date: "date of the first message",
    time: "time of the first message",
    size: "size",
    average_size: "mean size of a message",
    bytes_per_second: "bytes per second",
    bytes_per_minute: "bytes per minute",
    bytes_per_hour: "bytes per hour",
    latency: "mean latency",
    streams: "number of streams"
  ]

  @second 1_000_000_000

  @doc "Returns all choices with their titles."
  @spec choices() :: [{atom(), String.t()}]
  def choices, do: @choices

  @doc """
  Returns the choice with the given name from a form or a file, or the default.

      iex> Situ.Studio.Figures.choice("size", :rate)
      :size
      iex> Situ.Studio.Figures.choice("weight", :rate)
      :rate
  """
  @spec choice(term(), atom()) :: atom()
  def choice(text, usual) do
    case Enum.find(@choices, fn {name, _} -> Atom.to_string(name) == text end) do
      {name, _} -> name
      nil -> usual
    end
  end

  @doc "Summarizes streams; the mean latency is weighted by the number of messages."
  @spec sum([StreamInfo.t()]) :: t()
  def sum(streams) do
    timed =
      for %{first: first, last: last} when first != nil <- streams, do: {first, last || first}

    from = timed |> Enum.map(&elem(&1, 0)) |> Enum.min(fn -> nil end)
    to = timed |> Enum.map(&elem(&1, 1)) |> Enum.max(fn -> nil end)

    count = streams |> Enum.map(& &1.count) |> Enum.sum()

    %__MODULE__{
      streams: length(streams),
      count: count,
      bytes: streams |> Enum.map(& &1.bytes) |> Enum.sum(),
      from: from,
      to: to,
      length: from && to - from,
      rate:
        if(match?([_], streams), do: hd(streams).rate, else: StreamInfo.rate(count, from, to)),
      latency: latency(streams)
    }
  end

  @doc "Sets the length of a summary to the sum of the lengths of its sessions."
  @spec in_turn(t(), [t()]) :: t()
  def in_turn(%__MODULE__{} = all, parts) do
    lengths = for %{length: length} when length != nil <- parts, do: length
    %{all | length: if(lengths == [], do: all.length, else: Enum.sum(lengths))}
  end

  defp latency(streams) do
    known = for %{latency: ns, count: n} when ns != nil and n > 0 <- streams, do: {ns, n}
    total = known |> Enum.map(&elem(&1, 1)) |> Enum.sum()
    if total > 0, do: (known |> Enum.map(fn {ns, n} -> ns * n end) |> Enum.sum()) / total
  end

  @doc "Formats a statistic as text; empty if it is unknown. Times are UTC."
  @spec text(atom(), t()) :: String.t()
  def text(:none, _), do: ""
  # A recording that cannot be opened has no streams and no statistics.
  def text(_, %{streams: 0}), do: ""
  def text(:count, f), do: Integer.to_string(f.count)
  def text(:streams, %{streams: 1}), do: "1 stream"
  def text(:streams, f), do: "#{f.streams} streams"
  def text(:size, f), do: bytes(f.bytes)
  def text(:average_size, %{count: 0}), do: ""
  def text(:average_size, f), do: bytes(f.bytes / f.count)
  def text(:bytes_per_second, f), do: speed(f, 1, "s")
  def text(:bytes_per_minute, f), do: speed(f, 60, "min")
  def text(:bytes_per_hour, f), do: speed(f, 3_600, "h")
  def text(:rate, f), do: rate(f)
  def text(:per_minute, f), do: often(f, 60, "min")
  def text(:per_hour, f), do: often(f, 3_600, "h")
  def text(:latency, %{latency: nil}), do: ""
  def text(:latency, f), do: latency_text(f.latency)
  def text(_, %{from: nil}), do: ""
  def text(:duration, f), do: Situ.Time.format_duration(f.length)
  def text(:span, f), do: Situ.Time.format_duration(f.to - f.from)
  def text(:began, f), do: f.from |> clock() |> String.slice(0, 19)
  def text(:date, f), do: f.from |> clock() |> String.slice(0, 10)
  def text(:time, f), do: f.from |> clock() |> String.slice(11, 8)

  # The assumed upper bound for the clock skew between two machines.
  @skew 100_000_000
  @day 86_400 * @second

  @doc """
  Formats a mean latency. Returns "not real time" if the messages were not created in real time, as in a replayed
  recording or a simulation.

      iex> Enum.map([2_020_000, -5_000_000, -1_470_000_000], &Situ.Studio.Figures.latency_text/1)
      ["2.02 ms", "-5.00 ms", "not real time"]
  """
  @spec latency_text(number()) :: String.t()
  def latency_text(ns) when ns < -@skew or ns > @day, do: "not real time"
  def latency_text(ns), do: Situ.Time.format_duration(round(ns))

  defp clock(time), do: time |> Situ.Time.to_iso8601() |> String.replace("T", " ")

  defp rate(%{rate: nil, count: 1}), do: "1"
  defp rate(%{rate: nil}), do: ""
  defp rate(%{rate: hz}), do: how_often(hz)

  @doc """
  Formats a rate, given per second, in a readable unit.

      iex> Enum.map([3.0e9, 48_000, 25, 0.5, 1 / 3600, 2 / 86_400], &Situ.Studio.Figures.how_often/1)
      ["3.0 G/s", "48.0 k/s", "25.0/s", "30.0/min", "1.0/h", "2.0/d"]
  """
  @spec how_often(number()) :: String.t()
  def how_often(hz) when hz >= 1.0e9, do: "#{number(hz / 1.0e9)} G/s"
  def how_often(hz) when hz >= 1.0e6, do: "#{number(hz / 1.0e6)} M/s"
  def how_often(hz) when hz >= 1.0e4, do: "#{number(hz / 1.0e3)} k/s"
  def how_often(hz) when hz >= 1, do: "#{number(hz)}/s"
  def how_often(hz) when hz >= 1 / 60, do: "#{number(hz * 60)}/min"
  def how_often(hz) when hz >= 1 / 3600, do: "#{number(hz * 3600)}/h"
  def how_often(hz), do: "#{number(hz * 86_400)}/d"

  defp often(%{rate: nil}, _, _), do: ""
  defp often(%{rate: hz}, seconds, unit), do: "#{number(hz * seconds)}/#{unit}"

  defp speed(%{length: length, bytes: bytes}, seconds, unit) when length != nil and length > 0,
    do: "#{bytes(bytes * seconds * @second / length)}/#{unit}"

  defp speed(_, _, _), do: ""

  @doc "Formats a size in bytes with a decimal unit."
  @spec bytes(number()) :: String.t()
  def bytes(n) when is_integer(n) and n < 1_000, do: "#{n} B"
  def bytes(n) when n < 1_000, do: "#{number(n)} B"
  def bytes(n) when n < 1_000_000, do: "#{number(n / 1.0e3)} kB"
  def bytes(n) when n < 1_000_000_000, do: "#{number(n / 1.0e6)} MB"
  def bytes(n), do: "#{number(n / 1.0e9)} GB"

  @doc "Formats a number with about three digits."
  @spec number(number()) :: String.t()
  def number(x) when x >= 100, do: Integer.to_string(round(x))
  def number(x) when x >= 10, do: :erlang.float_to_binary(x / 1, [:compact, decimals: 1])
  def number(x), do: :erlang.float_to_binary(x / 1, [:compact, decimals: 2])
end
