defmodule Situ.Pipeline.Client do
  @moduledoc false
  # Sends requests to a pipeline's process, addressed by handle, stream, pid or name. If the pipeline has ended, returns
  # an error or the pipeline's result.
  alias Situ.{Argument, Error, Lifecycle, Pipeline}
  alias Situ.Application.{Directory, PipelineResults}
  alias Situ.Graph.{Builder, Additions, Handle}
  alias Situ.Lifecycle.Errors

  @start_example ~s|Situ.Pipeline.start_part(p, "Side", from: :checkpoint)|

  @spec stop_pipeline(Pipeline.target(), keyword()) :: Pipeline.result() | :ok
  def stop_pipeline(p, opts) do
    pid = resolve_pid(p)

    if inside_pipeline?(pid) or pid == self() do
      send(pid, :situ_stop)
      :ok
    else
      request = {:stop, Keyword.get(opts, :catch_up, Lifecycle.default_catch_up_ms())}
      call_process(pid, request, Keyword.get(opts, :timeout, :infinity), nil)
    end
  end

  @spec abandon_pipeline(Pipeline.target()) :: :ok | {:error, Error.t()}
  def abandon_pipeline(p), do: call_process(resolve_pid(p), :abandon, 1_000, nil)

  @spec stop_part(Pipeline.target(), String.t() | Situ.Node.t(), keyword()) ::
          :ok | {:error, Error.t()}
  def stop_part(p, part, opts) do
    pid = resolve_pid(p)
    path = part_path!(part)

    how = %{
      catch_up: Keyword.get(opts, :catch_up, Lifecycle.default_catch_up_ms()),
      checkpoint?: Keyword.get(opts, :checkpoint, false),
      forget?: Keyword.get(opts, :forget?, false)
    }

    request = {:stop_part, path, how}

    if inside_pipeline?(pid) do
      send(pid, put_elem(request, 0, :situ_stop_part))
      :ok
    else
      call_process(pid, request, Keyword.get(opts, :timeout, :infinity), nil)
    end
  end

  @spec start_part(Pipeline.target(), String.t() | Situ.Node.t(), keyword()) ::
          :ok | {:error, Error.t()}
  def start_part(p, part, opts) do
    from = Keyword.get(opts, :from, :fresh)

    unless from in [:fresh, :checkpoint] do
      Argument.raise_invalid!(from, "from: :fresh or from: :checkpoint", @start_example)
    end

    timeout = Keyword.get(opts, :timeout, :infinity)
    call_process(resolve_pid(p), {:start_part, part_path!(part), from}, timeout, nil)
  end

  defp part_path!(path) when is_binary(path), do: path
  defp part_path!(%Situ.Node{path: path}), do: path

  defp part_path!(other) do
    takes = "the path of a composite or component, or a node, as its second argument"
    Argument.raise_invalid!(other, takes, ~s|Situ.Pipeline.stop_part(p, "Side")|)
  end

  # Returns whether the caller is a component or handler of the pipeline itself.
  defp inside_pipeline?(pid), do: pid != nil and Process.get(:situ_pipeline) == pid

  @spec await_result(Pipeline.target(), timeout()) :: Pipeline.result()
  def await_result(p, timeout) do
    pid = resolve_pid(p)

    case PipelineResults.fetch_result(pid) do
      {:ok, result} -> result
      :error -> call_process(pid, :await, timeout, :archive)
    end
  end

  @spec pipeline_state(Pipeline.target()) :: atom()
  def pipeline_state(p) do
    case call_process(resolve_pid(p), :state, :infinity, nil) do
      {:error, %Error{code: :not_running}} -> :completed
      state -> state
    end
  end

  @doc "Adds to the graph of a running pipeline; on return, either all of the addition is running or none of it."
  @spec extend_pipeline(Pipeline.target(), (Pipeline.t() -> result)) ::
          {:ok, result} | {:error, Error.t()}
        when result: term()
  def extend_pipeline(p, fun) do
    with {:ok, {handle, graph}} <- call(p, :extension),
         handle = if(is_struct(p, Handle), do: %{handle | scope: p.scope}, else: handle),
         {:ok, {result, built}} <- build_extension(handle, graph, fun),
         :ok <- call(p, {:extend, Additions.extract_additions(built, graph)}),
         do: {:ok, result}
  end

  defp build_extension(handle, graph, fun) do
    {:ok, Builder.with_graph(handle, graph, fn -> fun.(handle) end)}
  rescue
    error in Error -> {:error, error}
  end

  @doc "Calls `fun` with the snapshots of all stages, while the sources are paused."
  @spec with_checkpoint(Pipeline.target(), (map() -> result), pos_integer()) ::
          {:ok, result} | {:error, Error.t()}
        when result: term()
  def with_checkpoint(p, fun, timeout) do
    with {:ok, ref, memories} <- call(p, {:checkpoint, timeout}) do
      try do
        {:ok, fun.(memories)}
      after
        send(resolve_pid(p), {:situ_thaw, ref})
      end
    end
  end

  @doc "Returns the server's reply, or `{:error, error}` if the pipeline has ended."
  @spec call(Pipeline.target(), term()) :: term()
  def call(p, request), do: call_process(resolve_pid(p), request, :infinity, nil)

  @doc "Works like `call/2`, but raises the error."
  @spec call!(Pipeline.target(), term()) :: term()
  def call!(p, request) do
    case call(p, request) do
      {:error, %Error{} = error} -> raise error
      answer -> answer
    end
  end

  defp call_process(nil, _request, _timeout, _), do: {:error, Errors.not_running()}

  defp call_process(pid, request, timeout, fallback) do
    GenServer.call(pid, request, timeout)
  catch
    :exit, {:timeout, _} -> {:error, Errors.request_timeout(request, timeout)}
    :exit, _ -> ended_reply(pid, fallback)
  end

  defp ended_reply(pid, :archive) do
    case PipelineResults.fetch_result(pid) do
      {:ok, result} -> result
      :error -> {:error, Errors.not_running()}
    end
  end

  defp ended_reply(_pid, nil), do: {:error, Errors.not_running()}

  @doc "Prints the live table of `Situ.inspect/2` every `ms` until the pipeline has ended."
  @spec print_live_table(Pipeline.target(), pos_integer(), pos_integer() | :infinity) :: :ok
  def print_live_table(_p, _ms, 0), do: :ok

  def print_live_table(p, ms, times) do
    if pipeline_state(p) == :completed do
      IO.puts("the pipeline has ended")
    else
      table = Situ.Diagnostics.format(call!(p, :info))
      IO.puts([IO.ANSI.clear(), IO.ANSI.home(), table])
      # Sleeping is right here, because a person reads the table.
      Process.sleep(ms)
      print_live_table(p, ms, if(times == :infinity, do: :infinity, else: times - 1))
    end
  end

  @doc "Returns the snapshot of a pipeline, or an error if it has ended or does not respond within `timeout` ms."
  @spec fetch_snapshot(pid(), timeout()) ::
          {:ok, Situ.Diagnostics.Snapshot.t()} | {:error, Error.t()}
  def fetch_snapshot(pid, timeout) do
    case call_process(pid, :info, timeout, nil) do
      {:error, error} -> {:error, error}
      snapshot -> {:ok, snapshot}
    end
  end

  @doc "Returns the counters of each connection by its id, or an error as `fetch_snapshot/2`."
  @spec fetch_counters(pid(), timeout()) ::
          {:ok, %{pos_integer() => Situ.Ports.Counters.t()}} | {:error, Error.t()}
  def fetch_counters(pid, timeout) do
    case call_process(pid, :counters, timeout, nil) do
      {:error, error} -> {:error, error}
      counters -> {:ok, counters}
    end
  end

  @doc "Reports movement that the pipeline's counters do not show, so that it does not count as stuck."
  @spec report_movement(Pipeline.target()) :: term()
  def report_movement(p), do: send(resolve_pid(p), :situ_moving)

  @doc "Calls a function on the node of the pipeline's process, because a clock can only be read on its own node."
  @spec call_on_node(pid(), module(), atom()) :: term()
  def call_on_node(pid, module, function) do
    :erpc.call(node(pid), module, function, [pid], 5_000)
  rescue
    error in ErlangError ->
      raise Error.new(:not_running, "the pipeline is not responding",
              why: "calling #{node(pid)} failed: #{inspect(error.original, limit: 5)}"
            )
  end

  @doc "Returns the process of a handle, a stream or a name."
  @spec resolve_pid(Pipeline.target()) :: pid() | nil
  def resolve_pid(%Handle{pid: pid}), do: pid
  def resolve_pid(%Situ.Stream{pipeline: p}), do: p.pid
  def resolve_pid(pid) when is_pid(pid), do: pid
  def resolve_pid(label) when is_binary(label), do: Directory.whereis(label)

  def resolve_pid(other) do
    if registered_name?(other),
      do: GenServer.whereis(other),
      else: Argument.raise_invalid!(other, :target, "Situ.Pipeline.info(p)")
  end

  defp registered_name?({:global, _}), do: true
  defp registered_name?({:via, _, _}), do: true
  # `{:ok, p}`, a common mistake, is not the name of a process on a node.
  defp registered_name?({:ok, _}), do: false
  defp registered_name?({name, node}), do: is_atom(name) and is_atom(node)
  defp registered_name?(name), do: is_atom(name)
end
