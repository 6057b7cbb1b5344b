defmodule Situ.Branch.Chained do
  @moduledoc false
  # A branch that is a linear chain of light operators, so that only data is passed along.
  alias Situ.Component.Callback
  alias Situ.Operator.Chain
  require Chain

  @enforce_keys [:chain, :fast, :paths, :result]
  defstruct [:chain, :fast, :paths, :result]

  @type t :: %__MODULE__{}

  @doc "Builds the chain from the inlet to the result. Returns `:error` if the graph has any other shape."
  @spec plan(Situ.Graph.t(), pos_integer(), {pos_integer(), atom()} | nil, term()) ::
          {:ok, t()} | :error
  def plan(graph, inlet, result, path) do
    next = Enum.group_by(graph.edges, fn {_, e} -> e.from end, fn {_, e} -> elem(e.to, 0) end)

    with {:ok, vertices} <- follow({inlet, :out}, next, graph.vertices, []),
         true <- length(vertices) == map_size(graph.vertices) - 1,
         true <- result == nil or result == last(vertices, inlet) do
      chain = Chain.new(Enum.map(vertices, & &1.opts))
      paths = {path, Enum.map(vertices, & &1.path)}

      {:ok,
       %__MODULE__{chain: chain, fast: not Chain.stateful?(chain), paths: paths, result: result}}
    else
      _ -> :error
    end
  end

  @spec push(t(), Situ.Message.t()) :: {Situ.Branch.outputs(), t()}
  def push(branch, message) do
    case value(branch, message.data, message) do
      {:skip, branch} -> {[], branch}
      {:value, data, branch} -> {[{message.originating_time, data}], branch}
    end
  end

  @doc "Runs the chain on the data alone. Returns `{:value, data, branch}` or `{:skip, branch}`."
  @spec value(t(), term(), Situ.Message.t()) :: {:value, term(), t()} | {:skip, t()}
  def value(%{fast: true, chain: chain} = branch, data, message) do
    case Chain.run(chain, data, message) do
      Chain.skip() -> {:skip, branch}
      data -> {:value, data, branch}
    end
  catch
    {:situ_step, index, kind, reason, stack} -> failed(branch, index, kind, reason, stack)
  end

  def value(%{chain: chain} = branch, data, message) do
    case Chain.run_stateful(chain, data, message) do
      {Chain.skip(), chain} -> {:skip, %{branch | chain: chain}}
      {data, chain} -> {:value, data, %{branch | chain: chain}}
    end
  catch
    {:situ_step, index, kind, reason, stack} -> failed(branch, index, kind, reason, stack)
  end

  defp follow(from, next, vertices, found) do
    case Map.get(next, from, []) do
      [] -> {:ok, Enum.reverse(found)}
      [id] -> operator(Map.fetch!(vertices, id), id, next, vertices, found)
      _several -> :error
    end
  end

  defp operator(%{module: :operator} = vertex, id, next, vertices, found),
    do: follow({id, :out}, next, vertices, [vertex | found])

  defp operator(_component, _id, _next, _vertices, _found), do: :error

  defp last([], inlet), do: {inlet, :out}
  defp last(vertices, _inlet), do: {List.last(vertices).id, :out}

  defp failed(%{paths: {path, steps}}, index, kind, reason, stack) do
    path = Situ.Branch.Path.to_string(path) <> "." <> Enum.at(steps, index)
    raise Callback.failure(path, :in, kind, reason, stack)
  end
end
