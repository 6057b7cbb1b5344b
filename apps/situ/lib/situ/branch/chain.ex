defmodule Situ.Branch.Chain do
  @moduledoc false
  # A branch that is a linear chain of light operators, so that only data is passed along.
  alias Situ.Component.Callback
  alias Situ.Operator.Chain
  require Chain

  @enforce_keys [:chain, :fast, :paths, :result]
  defstruct [:chain, :fast, :paths, :result]

  @type t :: %__MODULE__{}

  @doc "Builds the chain from the inlet to the result. Returns `:error` if the graph has any other shape."
  @spec from_graph(Situ.Graph.t(), pos_integer(), {pos_integer(), atom()} | nil, term()) ::
          {:ok, t()} | :error
  def from_graph(graph, inlet, result, path) do
    next = Enum.group_by(graph.edges, fn {_, e} -> e.from end, fn {_, e} -> elem(e.to, 0) end)

    with {:ok, vertices} <- follow_operators({inlet, :out}, next, graph.vertices, []),
         true <- length(vertices) == map_size(graph.vertices) - 1,
         true <- result == nil or result == last_output(vertices, inlet) do
      chain = Chain.build_steps(Enum.map(vertices, & &1.opts))
      paths = {path, Enum.map(vertices, & &1.path)}

      {:ok,
       %__MODULE__{chain: chain, fast: not Chain.stateful?(chain), paths: paths, result: result}}
    else
      _ -> :error
    end
  end

  @spec push(t(), Situ.Message.t()) :: {Situ.Branch.outputs(), t()}
  def push(branch, message) do
    case push_data(branch, message.data, message) do
      {:skip, branch} -> {[], branch}
      {:value, data, branch} -> {[{message.originating_time, data}], branch}
    end
  end

  @doc "Runs the chain on the data alone. Returns `{:value, data, branch}` or `{:skip, branch}`."
  @spec push_data(t(), term(), Situ.Message.t()) :: {:value, term(), t()} | {:skip, t()}
  def push_data(%{fast: true, chain: chain} = branch, data, message) do
    case Chain.run_stateless(chain, data, message) do
      Chain.skip() -> {:skip, branch}
      data -> {:value, data, branch}
    end
  catch
    {:situ_step, index, kind, reason, stack} ->
      raise_step_failure(branch, index, kind, reason, stack)
  end

  def push_data(%{chain: chain} = branch, data, message) do
    case Chain.run_stateful(chain, data, message) do
      {Chain.skip(), chain} -> {:skip, %{branch | chain: chain}}
      {data, chain} -> {:value, data, %{branch | chain: chain}}
    end
  catch
    {:situ_step, index, kind, reason, stack} ->
      raise_step_failure(branch, index, kind, reason, stack)
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

  defp raise_step_failure(%{paths: {path, steps}}, index, kind, reason, stack) do
    path = Situ.Branch.Path.to_string(path) <> "." <> Enum.at(steps, index)
    raise Callback.exception_error(path, :in, kind, reason, stack)
  end
end
