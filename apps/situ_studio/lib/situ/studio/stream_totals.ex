defmodule Situ.Studio.StreamTotals do
  @moduledoc false
  # Computes and formats the statistics next to the names in the trees of streams, recordings and
  # sessions.
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
  @spec list_choices() :: [{atom(), String.t()}]
  def list_choices, do: @choices

  @doc """
  Returns the choice with the given name from a form or a file, or the default.

      iex> Situ.Studio.StreamTotals.parse_choice("size", :rate)
      :size
      iex> Situ.Studio.StreamTotals.parse_choice("weight", :rate)
      :rate
  """
  @spec parse_choice(term(), atom()) :: atom()
  def parse_choice(text, usual) do
    case Enum.find(@choices, fn {name, _} -> Atom.to_string(name) == text end) do
      {name, _} -> name
      nil -> usual
    end
  end

  @doc """
  Summarizes streams; the mean latency is weighted by the number of messages.

      iex> alias Situ.Studio.{StreamInfo, StreamTotals}
      iex> s = 1_000_000_000
      iex> level = %StreamInfo{name: "A", shape: :signal, count: 101, bytes: 808, latency: 2.0e6, first: 0, last: s}
      iex> image = %StreamInfo{name: "Image", shape: :image, count: 1, bytes: 192, latency: 4.0e6, first: 0, last: 0}
      iex> both = StreamTotals.sum_streams([level, image])
      iex> for choice <- [:count, :size, :average_size, :bytes_per_second, :rate, :streams, :duration],
      ...>     do: StreamTotals.format_figure(choice, both)
      ["102", "1.0 kB", "9.8 B", "1.0 kB/s", "101/s", "2 streams", "1.00 s"]
      iex> StreamTotals.format_figure(:latency, both)
      "2.02 ms"
  """
  @spec sum_streams([StreamInfo.t()]) :: t()
  def sum_streams(streams) do
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
        if(match?([_], streams), do: hd(streams).rate, else: StreamInfo.mean_rate(count, from, to)),
      latency: mean_latency(streams)
    }
  end

  @doc "Sets the length of a summary to the sum of the lengths of its sessions."
  @spec add_lengths(t(), [t()]) :: t()
  def add_lengths(%__MODULE__{} = all, parts) do
    lengths = for %{length: length} when length != nil <- parts, do: length
    %{all | length: if(lengths == [], do: all.length, else: Enum.sum(lengths))}
  end

  defp mean_latency(streams) do
    known = for %{latency: ns, count: n} when ns != nil and n > 0 <- streams, do: {ns, n}
    total = known |> Enum.map(&elem(&1, 1)) |> Enum.sum()
    if total > 0, do: (known |> Enum.map(fn {ns, n} -> ns * n end) |> Enum.sum()) / total
  end

  @doc "Formats a statistic as text; empty if it is unknown. Times are UTC."
  @spec format_figure(atom(), t()) :: String.t()
  def format_figure(:none, _), do: ""
  # A recording that cannot be opened has no streams and no statistics.
  def format_figure(_, %{streams: 0}), do: ""
  def format_figure(:count, f), do: Integer.to_string(f.count)
  def format_figure(:streams, %{streams: 1}), do: "1 stream"
  def format_figure(:streams, f), do: "#{f.streams} streams"
  def format_figure(:size, f), do: format_bytes(f.bytes)
  def format_figure(:average_size, %{count: 0}), do: ""
  def format_figure(:average_size, f), do: format_bytes(f.bytes / f.count)
  def format_figure(:bytes_per_second, f), do: throughput_text(f, 1, "s")
  def format_figure(:bytes_per_minute, f), do: throughput_text(f, 60, "min")
  def format_figure(:bytes_per_hour, f), do: throughput_text(f, 3_600, "h")
  def format_figure(:rate, f), do: rate_text(f)
  def format_figure(:per_minute, f), do: rate_per(f, 60, "min")
  def format_figure(:per_hour, f), do: rate_per(f, 3_600, "h")
  def format_figure(:latency, %{latency: nil}), do: ""
  def format_figure(:latency, f), do: format_latency(f.latency)
  def format_figure(_, %{from: nil}), do: ""
  def format_figure(:duration, f), do: Situ.Time.format_duration(f.length)
  def format_figure(:span, f), do: Situ.Time.format_duration(f.to - f.from)
  def format_figure(:began, f), do: f.from |> format_time() |> String.slice(0, 19)
  def format_figure(:date, f), do: f.from |> format_time() |> String.slice(0, 10)
  def format_figure(:time, f), do: f.from |> format_time() |> String.slice(11, 8)

  # The assumed upper bound for the clock skew between two machines.
  @skew 100_000_000
  @day 86_400 * @second

  @doc """
  Formats a mean latency. Returns "not real time" if the messages were not created in real time, as in a replayed
  recording or a simulation.

      iex> Enum.map([2_020_000, -5_000_000, -1_470_000_000], &Situ.Studio.StreamTotals.format_latency/1)
      ["2.02 ms", "-5.00 ms", "not real time"]
  """
  @spec format_latency(number()) :: String.t()
  def format_latency(ns) when ns < -@skew or ns > @day, do: "not real time"
  def format_latency(ns), do: Situ.Time.format_duration(round(ns))

  defp format_time(time), do: time |> Situ.Time.to_iso8601() |> String.replace("T", " ")

  defp rate_text(%{rate: nil, count: 1}), do: "1"
  defp rate_text(%{rate: nil}), do: ""
  defp rate_text(%{rate: hz}), do: format_rate(hz)

  @doc """
  Formats a rate, given per second, in a readable unit.

      iex> Enum.map([3.0e9, 48_000, 25, 0.5, 1 / 3600, 2 / 86_400], &Situ.Studio.StreamTotals.format_rate/1)
      ["3.0 G/s", "48.0 k/s", "25.0/s", "30.0/min", "1.0/h", "2.0/d"]
  """
  @spec format_rate(number()) :: String.t()
  def format_rate(hz) when hz >= 1.0e9, do: "#{format_number(hz / 1.0e9)} G/s"
  def format_rate(hz) when hz >= 1.0e6, do: "#{format_number(hz / 1.0e6)} M/s"
  def format_rate(hz) when hz >= 1.0e4, do: "#{format_number(hz / 1.0e3)} k/s"
  def format_rate(hz) when hz >= 1, do: "#{format_number(hz)}/s"
  def format_rate(hz) when hz >= 1 / 60, do: "#{format_number(hz * 60)}/min"
  def format_rate(hz) when hz >= 1 / 3600, do: "#{format_number(hz * 3600)}/h"
  def format_rate(hz), do: "#{format_number(hz * 86_400)}/d"

  defp rate_per(%{rate: nil}, _, _), do: ""
  defp rate_per(%{rate: hz}, seconds, unit), do: "#{format_number(hz * seconds)}/#{unit}"

  defp throughput_text(%{length: length, bytes: bytes}, seconds, unit)
       when length != nil and length > 0,
       do: "#{format_bytes(bytes * seconds * @second / length)}/#{unit}"

  defp throughput_text(_, _, _), do: ""

  @doc "Formats a size in bytes with a decimal unit."
  @spec format_bytes(number()) :: String.t()
  def format_bytes(n) when is_integer(n) and n < 1_000, do: "#{n} B"
  def format_bytes(n) when n < 1_000, do: "#{format_number(n)} B"
  def format_bytes(n) when n < 1_000_000, do: "#{format_number(n / 1.0e3)} kB"
  def format_bytes(n) when n < 1_000_000_000, do: "#{format_number(n / 1.0e6)} MB"
  def format_bytes(n), do: "#{format_number(n / 1.0e9)} GB"

  @doc "Formats a number with about three digits."
  @spec format_number(number()) :: String.t()
  def format_number(x) when x >= 100, do: Integer.to_string(round(x))
  def format_number(x) when x >= 10, do: :erlang.float_to_binary(x / 1, [:compact, decimals: 1])
  def format_number(x), do: :erlang.float_to_binary(x / 1, [:compact, decimals: 2])
end
