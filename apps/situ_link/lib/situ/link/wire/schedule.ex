defmodule Situ.Link.Wire.Schedule do
  @moduledoc false
  # Decides which channel sends next: the highest priority first, round-robin within a priority.
  # Pure.
  defstruct queues: %{}, members: MapSet.new()
  @opaque t :: %__MODULE__{}

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc """
  Appends `key` to the queue of its priority, unless it is already queued.

      iex> alias Situ.Link.Wire.Schedule
      iex> schedule = Enum.reduce([a: 0, b: 5, c: 0, d: 5], Schedule.new(), fn {k, p}, s -> Schedule.put(s, k, p) end)
      iex> {b, schedule} = Schedule.take(schedule)
      iex> schedule = Schedule.put(schedule, b, 5)
      iex> {d, schedule} = Schedule.take(schedule)
      iex> {again, schedule} = Schedule.take(schedule)
      iex> {a, _} = Schedule.take(schedule)
      iex> {b, d, again, a}
      {:b, :d, :b, :a}
  """
  @spec put(t(), term(), integer()) :: t()
  def put(%__MODULE__{} = schedule, key, priority) do
    if MapSet.member?(schedule.members, key) do
      schedule
    else
      queue = Map.get(schedule.queues, priority, :queue.new())

      %__MODULE__{
        queues: Map.put(schedule.queues, priority, :queue.in(key, queue)),
        members: MapSet.put(schedule.members, key)
      }
    end
  end

  @spec take(t()) :: {term(), t()} | :empty
  def take(%__MODULE__{queues: queues}) when map_size(queues) == 0, do: :empty

  def take(%__MODULE__{queues: queues} = schedule) do
    priority = queues |> Map.keys() |> Enum.max()
    {{:value, key}, rest} = :queue.out(queues[priority])

    queues =
      if :queue.is_empty(rest),
        do: Map.delete(queues, priority),
        else: Map.put(queues, priority, rest)

    {key, %{schedule | queues: queues, members: MapSet.delete(schedule.members, key)}}
  end
end
