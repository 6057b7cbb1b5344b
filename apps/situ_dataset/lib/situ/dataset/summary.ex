defmodule Situ.Dataset.Summary do
  @moduledoc """
  Summarizes a partition, a session or a dataset: time spans, sizes and counts. `Situ.Dataset.summary/1`,
  `Situ.Dataset.Session.summary/1` and `Situ.Dataset.Partition.summary/1` return it. A summary of several items contains
  the coverage of their spans and the sums of the other fields.

    * `originating`, `creation`: the spans of the originating and creation times (`Situ.Interval`), empty if there are
      no messages
    * `streams_open`: the span from the first opening of a stream to the last close of a stream (ns; \\psi calls it the
      stream interval)
    * `size`: bytes of the messages, or of the file if its format does not state them; `streams`, `messages`: counts
    * `unknown`: number of partitions that could not be read and are not included
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

  @doc "Summarizes an open recording."
  @spec from_store(Store.t()) :: t()
  def from_store(%Situ.Recording{} = store) do
    streams = Store.streams(store)

    %__MODULE__{
      originating: to_interval(Store.interval(streams)),
      creation: to_interval(time_extent(streams, & &1.first_creation, & &1.last_creation)),
      streams_open:
        to_interval(time_extent(streams, &(&1.opened || &1.first), &(&1.closed || &1.last))),
      size: total_size(store, streams),
      streams: length(streams),
      messages: streams |> Enum.map(& &1.count) |> Enum.sum()
    }
  end

  # Most formats of other programs do not state the sizes of messages.
  defp total_size(store, streams) do
    case streams |> Enum.map(& &1.size) |> Enum.sum() do
      0 -> if Enum.any?(streams, &(&1.count > 0)), do: file_size(store.path), else: 0
      size -> size
    end
  end

  defp file_size(path) do
    case File.stat(path) do
      {:ok, %{type: :regular, size: size}} -> size
      _folder_or_address -> 0
    end
  end

  @doc "Returns the summary of a recording that cannot be read."
  @spec unknown_recording() :: t()
  def unknown_recording, do: %__MODULE__{unknown: 1}

  @doc """
  Combines several summaries: the coverage of the spans and the sums of the other fields.

      iex> a = %Situ.Dataset.Summary{originating: Situ.Interval.closed(10, 20), size: 3, streams: 1, messages: 2}
      iex> b = %Situ.Dataset.Summary{originating: Situ.Interval.closed(40, 50), size: 4, streams: 2, messages: 1}
      iex> sum = Situ.Dataset.Summary.sum([a, b])
      iex> {to_string(sum.originating), sum.size, sum.streams, sum.messages, Situ.Dataset.Summary.duration(sum)}
      {"[10,50]", 7, 3, 3, 40}
  """
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

  @doc "Returns the time (ns) from the first to the last originating time."
  @spec duration(t()) :: Situ.Time.duration()
  def duration(%__MODULE__{originating: interval}), do: Interval.span(interval)

  defp to_interval(nil), do: Interval.empty()
  defp to_interval({first, last}), do: Interval.closed(min(first, last), max(first, last))

  defp time_extent(streams, first, last) do
    firsts = for s <- streams, time = first.(s), do: time
    lasts = for s <- streams, time = last.(s), do: time
    if firsts == [] or lasts == [], do: nil, else: {Enum.min(firsts), Enum.max(lasts)}
  end
end
