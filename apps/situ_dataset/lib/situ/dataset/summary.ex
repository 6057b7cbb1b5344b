defmodule Situ.Dataset.Summary do
  @moduledoc """
  Spans, sizes and counts of a partition, a session or a dataset; those of a group are the coverage and the sums of
  its members.

    * `originating`, `creation`: the spans of originating and creation times, `Situ.Interval`, empty without
      messages
    * `streams_open`: the span from the first stream's opening to the last one's close (ns; what \\psi calls the
      stream interval)
    * `size`: payload bytes; `streams`, `messages`: counts
    * `unknown`: how many partitions could not be read and are left out

      iex> a = %Situ.Dataset.Summary{originating: Situ.Interval.closed(10, 20), size: 3, streams: 1, messages: 2}
      iex> b = %Situ.Dataset.Summary{originating: Situ.Interval.closed(40, 50), size: 4, streams: 2, messages: 1}
      iex> sum = Situ.Dataset.Summary.sum([a, b])
      iex> {to_string(sum.originating), sum.size, sum.streams, sum.messages, Situ.Dataset.Summary.duration(sum)}
      {"[10,50]", 7, 3, 3, 40}
  """
  alias Situ.{Interval, Store}

  defstruct originating: %Interval{left: 0, right: 0},
            creation: %Interval{left: 0, right: 0},
            streams_open: %Interval{left: 0, right: 0},
            size: 0,
            streams: 0,
            messages: 0,
            unknown: 0

  @type t :: %__MODULE__{
          originating: Interval.t(),
          creation: Interval.t(),
          streams_open: Interval.t(),
          size: non_neg_integer(),
          streams: non_neg_integer(),
          messages: non_neg_integer(),
          unknown: non_neg_integer()
        }

  @doc "Of an open recording."
  @spec of(Store.t()) :: t()
  def of(%Store.Handle{} = store) do
    streams = Store.streams(store)

    %__MODULE__{
      originating: span(Store.interval(streams)),
      creation: span(extent(streams, & &1.first_creation, & &1.last_creation)),
      streams_open: span(extent(streams, &(&1.opened || &1.first), &(&1.closed || &1.last))),
      size: streams |> Enum.map(& &1.size) |> Enum.sum(),
      streams: length(streams),
      messages: streams |> Enum.map(& &1.count) |> Enum.sum()
    }
  end

  @doc "Of one that cannot be read."
  @spec unknown() :: t()
  def unknown, do: %__MODULE__{unknown: 1}

  @doc "Of several: coverage of the spans, sums of the rest."
  @spec sum([t()]) :: t()
  def sum(summaries) do
    total = fn field -> summaries |> Enum.map(&Map.fetch!(&1, field)) |> Enum.sum() end
    cover = fn field -> summaries |> Enum.map(&Map.fetch!(&1, field)) |> Interval.coverage() end

    %__MODULE__{
      originating: cover.(:originating),
      creation: cover.(:creation),
      streams_open: cover.(:streams_open),
      size: total.(:size),
      streams: total.(:streams),
      messages: total.(:messages),
      unknown: total.(:unknown)
    }
  end

  @doc "From the first to the last originating time, ns."
  @spec duration(t()) :: Situ.Time.duration()
  def duration(%__MODULE__{originating: interval}), do: Interval.span(interval)

  defp span(nil), do: Interval.empty()
  defp span({first, last}), do: Interval.closed(min(first, last), max(first, last))

  defp extent(streams, first, last) do
    firsts = for s <- streams, time = first.(s), do: time
    lasts = for s <- streams, time = last.(s), do: time
    if firsts == [] or lasts == [], do: nil, else: {Enum.min(firsts), Enum.max(lasts)}
  end
end
