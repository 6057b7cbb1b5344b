defmodule Situ.Store.S3.Cost do
  @moduledoc false
  # Adds up the requests and bytes of an operation in the process that runs it.

  @kinds ~w(reads writes deletes sent received)a
  @zero Map.new(@kinds, &{&1, 0})

  @typedoc "GET and HEAD requests; PUT, POST and LIST requests; DELETE requests; bytes of bodies."
  @type t :: %{
          reads: non_neg_integer(),
          writes: non_neg_integer(),
          deletes: non_neg_integer(),
          sent: non_neg_integer(),
          received: non_neg_integer()
        }

  @doc "Runs a function and returns its result and its cost."
  @spec measure((() -> result)) :: {result, t()} when result: term()
  def measure(run) do
    before = Process.put(__MODULE__, @zero)
    result = run.()
    cost = Process.get(__MODULE__)

    if before,
      do: Process.put(__MODULE__, add_costs(before, cost)),
      else: Process.delete(__MODULE__)

    {result, cost}
  end

  @doc "Adds the cost in a reply of object_port, or of another process."
  @spec add(map() | nil) :: :ok
  def add(cost) when is_map(cost) do
    if before = Process.get(__MODULE__),
      do: Process.put(__MODULE__, add_costs(before, parse_cost(cost)))

    :ok
  end

  def add(nil), do: :ok

  defp parse_cost(cost),
    do: Map.new(@kinds, &{&1, Map.get(cost, &1) || Map.get(cost, Atom.to_string(&1), 0)})

  defp add_costs(a, b), do: Map.merge(a, b, fn _, x, y -> x + y end)
end
