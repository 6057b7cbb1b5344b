defmodule Situ.Parallel.PendingOutputs do
  @moduledoc false
  # The times whose outputs are undecided, in order, with the live branches at each time, their values, and the number
  # of branches that may still add a value.

  @enforce_keys [:missing, :creator]
  defstruct [:missing, :creator, waiting: %{}, order: :queue.new()]

  @typedoc "The branches of an output: the first n positions, or keys."
  @type live :: non_neg_integer() | [term()]
  @type t :: %__MODULE__{}

  @doc "Builds an empty state. `creator` builds the output from the list or map of values."
  @spec new(:drop | {:value, term()}, (list() | map() -> term())) :: t()
  def new(missing, creator), do: %__MODULE__{missing: missing, creator: creator}

  @doc "Returns the number of waiting times."
  @spec waiting_count(t()) :: non_neg_integer()
  def waiting_count(entries), do: map_size(entries.waiting)

  @doc "Returns the first waiting time."
  @spec first_time(t()) :: {:value, Situ.Time.t()} | :empty
  def first_time(entries), do: :queue.peek(entries.order)

  @doc "Adds a time at which `open` branches are undecided."
  @spec add_time(t(), Situ.Time.t(), live(), map(), non_neg_integer()) :: t()
  def add_time(entries, time, live, values, open) do
    entry = %{live: live, values: values, open: open}
    waiting = Map.put(entries.waiting, time, entry)
    %{entries | waiting: waiting, order: :queue.in(time, entries.order)}
  end

  @doc "Adds the value of a branch at a time that is waiting for it."
  @spec put_value(t(), Situ.Time.t(), term(), term()) :: t()
  def put_value(%{waiting: waiting} = entries, time, key, value) do
    %{^time => %{values: values, open: open} = entry} = waiting
    entry = %{entry | values: Map.put(values, key, value), open: open - 1}
    %{entries | waiting: %{waiting | time => entry}}
  end

  @doc "Records that a branch has no value at these times, which are waiting for it."
  @spec mark_missing(t(), [Situ.Time.t()]) :: t()
  def mark_missing(entries, times) do
    Enum.reduce(times, entries, fn time, entries ->
      update_entry(entries, time, &%{&1 | open: &1.open - 1})
    end)
  end

  defp update_entry(entries, time, fun),
    do: %{entries | waiting: Map.update!(entries.waiting, time, fun)}

  @doc "Takes the decided outputs, up to the first undecided time."
  @spec take_decided(t()) :: {[Situ.Component.action()], t()}
  def take_decided(entries), do: flush_decided(entries, [])

  defp flush_decided(entries, outputs) do
    with {:value, time} <- :queue.peek(entries.order),
         %{open: 0} = entry <- Map.fetch!(entries.waiting, time) do
      order = :queue.drop(entries.order)
      entries = %{entries | order: order, waiting: Map.delete(entries.waiting, time)}
      flush_decided(entries, build_output(entries, time, entry.live, entry.values) ++ outputs)
    else
      _ -> {Enum.reverse(outputs), entries}
    end
  end

  @doc "Builds the output of a time at which all values are known."
  @spec build_output(t(), Situ.Time.t(), live(), map()) :: [Situ.Component.action()]
  def build_output(entries, time, live, values) do
    case {map_size(values) == live_count(live), entries.missing} do
      {true, _} ->
        [{:out, time, entries.creator.(shape_values(live, values, nil))}]

      {false, {:value, default}} ->
        [{:out, time, entries.creator.(shape_values(live, values, default))}]

      {false, :drop} ->
        []
    end
  end

  defp shape_values(n, values, default) when is_integer(n),
    do: for(key <- live_keys(n), do: Map.get(values, key, default))

  defp shape_values(keys, values, _default) when map_size(values) == length(keys), do: values
  defp shape_values(keys, values, default), do: Map.new(keys, &{&1, Map.get(values, &1, default)})

  @doc "Returns the keys of live branches."
  @spec live_keys(live()) :: [term()]
  def live_keys(n) when is_integer(n), do: Enum.to_list(0..(n - 1)//1)
  def live_keys(keys), do: keys

  @doc "Returns the number of live branches."
  @spec live_count(live()) :: non_neg_integer()
  def live_count(n) when is_integer(n), do: n
  def live_count(keys), do: length(keys)
end
