defmodule Situ.Graph.Builder do
  @moduledoc false
  # Holds a graph while it is being built. The graph is in the dictionary of the process that builds it: a pipeline
  # runs `build/2` itself, so adding a component is a map update. A pipeline that was opened empty is built by another
  # process through calls.
  alias Situ.{Error, Graph}
  alias Situ.Graph.Handle

  @doc "Opens a graph in the calling process and returns its handle."
  @spec open_graph(Graph.t(), pid()) :: Handle.t()
  def open_graph(graph \\ %Graph{}, pid \\ self()) do
    ref = make_ref()
    Process.put({__MODULE__, ref}, graph)
    %Handle{pid: pid, ref: ref}
  end

  @doc "Removes the graph from the process and returns it."
  @spec close_graph(Handle.t()) :: Graph.t() | nil
  def close_graph(%Handle{ref: ref}), do: Process.delete({__MODULE__, ref})

  @doc "Returns the current graph."
  @spec current_graph(Handle.t()) :: Graph.t() | nil
  def current_graph(%Handle{ref: ref}), do: Process.get({__MODULE__, ref})

  @spec build_graph((Handle.t() -> result)) :: {Graph.t(), result} when result: term()
  def build_graph(fun) do
    handle = open_graph()

    try do
      result = fun.(handle)
      {current_graph(handle), result}
    after
      close_graph(handle)
    end
  end

  @doc "Runs `fun` while this process holds `graph`; returns its result and the graph with its additions."
  @spec with_graph(Handle.t(), Graph.t(), (() -> result)) :: {result, Graph.t()}
        when result: term()
  def with_graph(%Handle{ref: ref}, graph, fun) do
    # A handler may extend the pipeline while it holds a graph, too.
    outer = Process.put({__MODULE__, ref}, graph)

    try do
      result = fun.()
      {result, Process.get({__MODULE__, ref})}
    after
      if outer, do: Process.put({__MODULE__, ref}, outer), else: Process.delete({__MODULE__, ref})
    end
  end

  @doc "Applies `change`, which returns `{result, graph}` or raises, to the handle's graph."
  @spec update_graph(Handle.t(), (Graph.t() -> {result, Graph.t()})) :: result when result: term()
  def update_graph(%Handle{ref: ref} = handle, change) do
    case Process.get({__MODULE__, ref}) do
      nil -> update_remote(handle, change)
      graph -> update_local(ref, graph, change)
    end
  end

  defp update_local(ref, graph, change) do
    {result, graph} = change.(graph)
    Process.put({__MODULE__, ref}, graph)
    result
  end

  defp update_remote(%Handle{pid: pid}, _change) when pid == self(),
    do: raise(already_running_error())

  defp update_remote(%Handle{pid: pid}, change) do
    case GenServer.call(pid, {:build, change}) do
      {:ok, result} -> result
      {:error, error} -> raise error
    end
  catch
    :exit, {reason, _} when reason in [:noproc, :normal, :shutdown] ->
      raise Error.new(:not_running, "the pipeline has ended")
  end

  @doc "Returns the error for a change to a graph that is already running."
  @spec already_running_error() :: Error.t()
  def already_running_error do
    Error.new(:pipeline_running, "the pipeline is already running",
      why: "components and connections are fixed when it starts",
      fix: "add components before it starts; to look at a running pipeline use Situ.attach_tap/3"
    )
  end
end
