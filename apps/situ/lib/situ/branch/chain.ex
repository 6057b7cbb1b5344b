defmodule Situ.Branch.Chain do
  @moduledoc false
  # A branch that is a linear chain of light operators, so that only data is passed along. Its `shape`, the part that
  # never changes, is shared by all branches that were built alike.
  alias Situ.Component.Callback
  alias Situ.Operator.Chain
  require Chain

  @enforce_keys [:steps, :shape]
  defstruct [:steps, :shape]

  @type t :: %__MODULE__{
          steps: Chain.steps(),
          shape: %{fast: boolean(), names: [String.t()], output?: boolean()}
        }
  @typep failure ::
           {:situ_step, index :: non_neg_integer(), kind :: atom(), reason :: term(), list()}

  @doc "Builds the chain from the inlet to the result. Returns `:error` if the graph has any other shape."
  @spec from_graph(Situ.Graph.t(), pos_integer(), {pos_integer(), atom()} | nil) ::
          {:ok, t()} | :error
  def from_graph(graph, inlet, result) do
    next = Enum.group_by(graph.edges, fn {_, e} -> e.from end, fn {_, e} -> elem(e.to, 0) end)

    with {:ok, vertices} <- follow_operators({inlet, :out}, next, graph.vertices, []),
         true <- length(vertices) == map_size(graph.vertices) - 1,
         true <- result == nil or result == last_output(vertices, inlet) do
      steps = Chain.build_steps(Enum.map(vertices, & &1.opts))
      names = Enum.map(vertices, & &1.path)
      shape = %{fast: not Chain.stateful?(steps), names: names, output?: result != nil}
      {:ok, %__MODULE__{steps: steps, shape: shape}}
    else
      _ -> :error
    end
  end

  @doc """
  Runs the chain on the data. Returns the branch if it has state. Throws `t:failure/0` if an operator raises.
  """
  @spec push_data(t(), term(), Situ.Message.t()) ::
          {:value, term()} | :skip | {:value, term(), t()} | {:skip, t()}
  def push_data(%{shape: %{fast: true}, steps: steps}, data, message) do
    case Chain.run_stateless(steps, data, message) do
      Chain.skip() -> :skip
      data -> {:value, data}
    end
  end

  def push_data(%{steps: steps, shape: shape}, data, message) do
    case Chain.run_stateful(steps, data, message) do
      {Chain.skip(), steps} -> {:skip, %__MODULE__{steps: steps, shape: shape}}
      {data, steps} -> {:value, data, %__MODULE__{steps: steps, shape: shape}}
    end
  end

  defp follow_operators(from, next, vertices, found) do
    case Map.get(next, from, []) do
      [] -> {:ok, Enum.reverse(found)}
      [id] -> follow_vertex(Map.fetch!(vertices, id), id, next, vertices, found)
      _several -> :error
    end
  end

  defp follow_vertex(%{module: :operator} = vertex, id, next, vertices, found),
    do: follow_operators({id, :out}, next, vertices, [vertex | found])

  defp follow_vertex(_component, _id, _next, _vertices, _found), do: :error

  defp last_output([], inlet), do: {inlet, :out}
  defp last_output(vertices, _inlet), do: {List.last(vertices).id, :out}

  @doc "Raises the error of a failed operator in the branch at `path`."
  @spec raise_failure(t(), String.t(), failure()) :: no_return()
  def raise_failure(%{shape: %{names: names}}, path, {:situ_step, index, kind, reason, stack}) do
    path = path <> "." <> Enum.at(names, index)
    raise Callback.exception_error(path, :in, kind, reason, stack)
  end
end
