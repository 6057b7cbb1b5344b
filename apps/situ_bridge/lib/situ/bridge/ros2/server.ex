defmodule Situ.Bridge.Ros2.Server do
  @moduledoc false
  # Offers a ROS 2 service. The server is a node with a separate Zenoh session, and runs a process for each request.
  use GenServer
  require Logger
  alias Situ.Bridge.Ros.Wire
  alias Situ.Bridge.Ros2.{Client, Keys, Zenoh}
  alias Situ.Error

  @service_id 1
  @node_id 2
  @token_id 3
  @restart_ms 1_000
  @timeout_ms 5_000

  def start_link(service, type, text, fun, opts) do
    {timeout, opts} = Keyword.pop(opts, :timeout, @timeout_ms)
    opts = Situ.Options.validate!(opts, Zenoh.options())

    with {:ok, service_info} <- Client.describe_service(service, type, text),
         {:ok, program} <- Zenoh.find_program() do
      args = %{opts: opts, program: program, fun: fun, node: Zenoh.node_name(opts)}
      {:ok, server} = GenServer.start_link(__MODULE__, Map.merge(service_info, args))
      await_ready(server, timeout, opts)
    end
  end

  defp await_ready(server, timeout, opts) do
    if GenServer.call(server, {:ready, timeout}, :infinity) do
      {:ok, server}
    else
      GenServer.stop(server)

      {:error,
       Error.new(:ros_unreachable, "no router at #{opts[:router]}",
         why: "after #{timeout} ms",
         fix: "start `rmw_zenohd`, or name another router with `router:`"
       )}
    end
  end

  @impl true
  def init(args) do
    Process.flag(:trap_exit, true)
    port = Zenoh.open(args.program, args.opts[:router])
    {:ok, Map.merge(args, %{port: port, up?: false, ready_caller: nil, workers: %{}})}
  end

  @impl true
  def handle_call({:ready, _timeout}, _from, %{up?: true} = state), do: {:reply, true, state}

  def handle_call({:ready, timeout}, from, state) do
    Process.send_after(self(), :late, timeout)
    {:noreply, %{state | ready_caller: from}}
  end

  @impl true
  def handle_info({port, {:data, frame}}, %{port: port} = state),
    do: {:noreply, frame |> Zenoh.parse_frame() |> handle_frame(state)}

  # Callers whose requests are lost get an error from Zenoh.
  def handle_info({port, {:exit_status, status}}, %{port: port} = state) do
    Logger.warning("zenoh_port ended with status #{status}; restarting it")
    Process.send_after(self(), :restart, @restart_ms)
    {:noreply, %{state | port: nil, up?: false, workers: %{}}}
  end

  def handle_info(:restart, state),
    do: {:noreply, %{state | port: Zenoh.open(state.program, state.opts[:router])}}

  def handle_info(:late, state), do: {:noreply, reply_ready(state, false)}

  def handle_info({:EXIT, worker, reason}, %{workers: workers} = state)
      when is_map_key(workers, worker) do
    {{request, attachment}, workers} = Map.pop(workers, worker)
    send_answer(state, request, attachment, worker_result(reason))
    {:noreply, %{state | workers: workers}}
  end

  def handle_info({:EXIT, from, reason}, state) when is_pid(from) do
    # The result of a worker from before a restart is dropped, because its request no longer exists.
    if reason == :normal or match?({:answer, _}, reason),
      do: {:noreply, state},
      else: {:stop, reason, state}
  end

  def handle_info(_other, state), do: {:noreply, state}

  defp worker_result({:answer, result}), do: result
  defp worker_result(reason), do: {:error, "the server failed: #{inspect(reason, limit: 20)}"}

  defp send_answer(state, request, attachment, {:ok, bytes}),
    do: Zenoh.send_answer(state.port, @service_id, request, {:ok, attachment, bytes})

  defp send_answer(state, request, _attachment, {:error, why}),
    do: Zenoh.send_answer(state.port, @service_id, request, {:error, to_string(why)})

  defp handle_frame({:open, session}, %{opts: opts, port: port} = state) do
    service_info = {state.name, state.type, state.hash, nil}
    key = Keys.service_key(opts[:domain], state.name, state.type, state.hash)
    Zenoh.declare_token(port, @node_id, Keys.node_token(opts[:domain], session, state.node))
    Zenoh.declare_service(port, @service_id, key)

    Zenoh.declare_token(
      port,
      @token_id,
      Keys.endpoint_token(:server, opts[:domain], session, state.node, service_info)
    )

    reply_ready(%{state | up?: true}, true)
  end

  defp handle_frame({:request, _id, request, attachment, payload}, state) do
    case Keys.reply_attachment(attachment, System.os_time(:nanosecond)) do
      {:ok, attachment} ->
        worker = spawn_link(fn -> exit({:answer, run_request(state, payload)}) end)
        %{state | workers: Map.put(state.workers, worker, {request, attachment})}

      :error ->
        why =
          "a ROS 2 request must have an attachment with its number, its time and the id of the client"

        Zenoh.send_answer(state.port, @service_id, request, {:error, why})
        state
    end
  end

  defp handle_frame({:trouble, _id, why}, state) do
    Logger.warning("Zenoh: #{why}")
    state
  end

  defp handle_frame(_other, state), do: state

  defp reply_ready(%{ready_caller: nil} = state, _up?), do: state

  defp reply_ready(state, up?) do
    GenServer.reply(state.ready_caller, up?)
    %{state | ready_caller: nil}
  end

  defp run_request(%{definition: definition, fun: fun}, payload) do
    with {:ok, request} <- Wire.decode(definition.request, payload, :cdr),
         {:ok, response} <- fun.(request),
         do: Wire.encode(definition.response, response, :cdr)
  rescue
    error -> {:error, Exception.message(error)}
  end

  @impl true
  def terminate(_reason, state) do
    for {worker, _} <- state.workers, do: Process.exit(worker, :kill)
    Zenoh.close(state.port)
  end
end
