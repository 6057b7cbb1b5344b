defmodule Situ.Diagnostics.Averages do
  @moduledoc false
  # Computes means over a time span from totals that only grow. It keeps marks of earlier totals; the window is the
  # difference between the current totals and the newest mark that is old enough. Pure.
  alias Situ.Diagnostics.Window
  alias Situ.Ports.Counters

  @enforce_keys [:span]
  defstruct [:span, marks: []]

  @type edges :: %{pos_integer() => Counters.totals()}
  @type t :: %__MODULE__{span: pos_integer(), marks: [{Situ.Time.t(), edges()}]}

  @zero %{
    emitted: 0,
    processed: 0,
    dropped: 0,
    created: 0,
    posted: 0,
    latency: 0,
    busy: 0,
    queue: 0,
    size: 0,
    sized: 0
  }

  @doc "Starts at `time` with totals of zero."
  @spec new(pos_integer(), Situ.Time.t()) :: t()
  def new(span, time), do: %__MODULE__{span: span, marks: [{time, %{}}]}

  @doc "Adds a mark of the totals at `time` unless the last mark is too recent; this keeps at most about 20 marks."
  @spec add_mark(t(), Situ.Time.t(), edges()) :: t()
  def add_mark(%__MODULE__{marks: [{last, _} | _], span: span} = averages, time, _edges)
      when time <= last or time - last < div(span, 16),
      do: averages

  def add_mark(%__MODULE__{marks: marks} = averages, time, edges) do
    {later, earlier} = Enum.split_while(marks, fn {at, _} -> at > time - averages.span end)
    %{averages | marks: [{time, edges} | later ++ Enum.take(earlier, 1)]}
  end

  @doc "Returns the window of each edge that ends at `time` with these totals."
  @spec build_windows(t(), Situ.Time.t(), edges()) :: %{pos_integer() => Window.t()}
  def build_windows(%__MODULE__{marks: marks, span: span}, time, edges) do
    {from, before} = Enum.find(marks, List.last(marks), fn {at, _} -> at <= time - span end)

    Map.new(edges, fn {id, now} ->
      {id, window_between(Map.get(before, id, @zero), now, time - from)}
    end)
  end

  @doc "Returns the means since the start, with the keys of `Situ.Diagnostics.Edge`."
  @spec overall_means(Counters.totals()) :: map()
  def overall_means(totals) do
    all = window_between(@zero, totals, 0)

    %{
      created_mean: all.created || 0,
      posted_mean: all.posted || 0,
      latency_mean: all.latency || 0,
      handling_mean: all.handling || 0,
      queue_mean: all.queue || 0.0,
      size_mean: all.size || 0
    }
  end

  defp window_between(before, now, span) do
    d = Map.new(now, fn {key, value} -> {key, value - before[key]} end)

    %Window{
      span: span,
      emitted: d.emitted,
      processed: d.processed,
      dropped: d.dropped,
      created: integer_mean(d.created * 1000, d.emitted),
      posted: integer_mean(d.posted * 1000, d.emitted),
      latency: integer_mean(d.latency * 1000, d.processed),
      handling: integer_mean(d.busy, d.processed),
      queue: if(d.processed > 0, do: d.queue / d.processed),
      size: integer_mean(d.size, d.sized)
    }
  end

  defp integer_mean(_sum, 0), do: nil
  defp integer_mean(sum, n), do: div(sum, n)
end
