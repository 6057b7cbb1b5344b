defmodule Situ.Simulation.Timers do
  @moduledoc false
  # The timers of a simulation, ordered by virtual time.

  defstruct order: :gb_sets.empty(), by_ref: %{}, count: 0

  @type timer :: {due :: integer(), reference(), pid(), message :: term()}
  @type t :: %__MODULE__{
          order: :gb_sets.set({integer(), non_neg_integer(), reference()}),
          by_ref: %{reference() => {non_neg_integer(), timer()}},
          count: non_neg_integer()
        }

  @spec empty?(t()) :: boolean()
  def empty?(%__MODULE__{by_ref: by_ref}), do: by_ref == %{}

  @doc "Returns whether a timer is due at `time`."
  @spec due_within?(t(), integer()) :: boolean()
  def due_within?(%__MODULE__{by_ref: by_ref}, _time) when by_ref == %{}, do: false
  def due_within?(%__MODULE__{order: order}, time), do: elem(:gb_sets.smallest(order), 0) <= time

  @spec add(t(), timer()) :: t()
  def add(%__MODULE__{count: n} = timers, {due, ref, _pid, _message} = timer) do
    order = :gb_sets.add_element({due, n, ref}, timers.order)
    %{timers | order: order, by_ref: Map.put(timers.by_ref, ref, {n, timer}), count: n + 1}
  end

  @spec delete(t(), reference()) :: t()
  def delete(%__MODULE__{by_ref: by_ref} = timers, ref) do
    case Map.pop(by_ref, ref) do
      {nil, _} ->
        timers

      {{n, {due, _, _, _}}, by_ref} ->
        %{timers | order: :gb_sets.del_element({due, n, ref}, timers.order), by_ref: by_ref}
    end
  end

  @spec delete_process(t(), pid()) :: t()
  def delete_process(%__MODULE__{by_ref: by_ref} = timers, pid) do
    refs = for {ref, {_n, {_, _, ^pid, _}}} <- by_ref, do: ref
    Enum.reduce(refs, timers, &delete(&2, &1))
  end

  @doc "Returns the timers that are due at `now`, or else the next ones, all due at the same time."
  @spec list_next(t(), integer()) :: [timer()]
  def list_next(%__MODULE__{order: order, by_ref: by_ref}, now) do
    {first, _n, _ref} = :gb_sets.smallest(order)
    last = max(first, now)

    order
    |> :gb_sets.to_list()
    |> Enum.take_while(fn {due, _n, _ref} -> due <= last end)
    |> Enum.map(fn {_due, _n, ref} -> elem(by_ref[ref], 1) end)
  end
end
