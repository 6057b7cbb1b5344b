defmodule Situ.Stage.Probe do
  @moduledoc false
  # Taps on streams inside a chain: a step that sends a copy of what passes to the tap's process.
  alias Situ.Stage
  alias Situ.Stage.Counters

  @doc "Inserts a probe behind the operator at `index` (behind the component itself for 0 of a stage with a tail)."
  @spec add(Stage.t(), term(), non_neg_integer(), pid(), Counters.t()) :: Stage.t()
  def add(state, tag, index, pid, counters) do
    me = self()

    id =
      state.vertices
      |> Enum.at(index)
      |> Map.fetch!(:outputs)
      |> hd()
      |> elem(1)
      |> Map.fetch!(:source_id)

    look = fn data, message ->
      age = message.creation_time - message.originating_time
      Counters.emitted(counters, 1, age, age)
      send(pid, {:"$gen_consumer", {me, tag}, [%{message | data: data, source_id: id}]})
    end

    step = {:each2, look, {:probe, tag}}
    update(%{state | probes: [{tag, pid} | state.probes]}, &insert(&1, index, step))
  end

  @doc "Takes the probe away again."
  @spec remove(Stage.t(), term()) :: Stage.t()
  def remove(state, tag) do
    probes = Enum.reject(state.probes, &(elem(&1, 0) == tag))

    update(%{state | probes: probes}, fn chain ->
      Enum.reject(chain, &(elem(&1, 2) == {:probe, tag}))
    end)
  end

  @doc "Tells the taps that nothing more will come."
  @spec close(Stage.t(), Situ.Time.t()) :: :ok
  def close(state, time) do
    for {tag, pid} <- state.probes,
        do: send(pid, {:"$gen_consumer", {self(), tag}, {:cancel, {:shutdown, {:closed, time}}}})

    :ok
  end

  # In front of the first step of a later operator.
  defp insert(steps, index, step) do
    {before, rest} = Enum.split_while(steps, &(is_tuple(elem(&1, 2)) or elem(&1, 2) <= index))
    before ++ [step | rest]
  end

  defp update(%{kind: :chain} = state, fun), do: %{state | chain: fun.(state.chain)}
  defp update(%{tail: nil} = state, _fun), do: state
  defp update(%{tail: tail} = state, fun), do: %{state | tail: %{tail | chain: fun.(tail.chain)}}
end
