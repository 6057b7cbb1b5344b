defmodule Situ.Bridge.Ros2.Client do
  @moduledoc false
  # Calls a ROS 2 service. Each client is a node with a separate Zenoh session.
  use GenServer
  alias Situ.Bridge.Ros.{Definition, Wire}
  alias Situ.Bridge.Ros2.{Keys, TypeHash, Zenoh}
  alias Situ.Error

  @node_id 0
  @token_id 1
  # The ids of requests start at this number.
  @first_id 16
  @last_id 0xFFFFFFFF

  @doc "Calls a service once with a temporary client."
  def call(service, type, text, request, opts) do
    {timeout, opts} = Keyword.pop(opts, :timeout, 5_000)

    with {:ok, client} <- start_link(service, type, text, opts) do
      result = send_request(client, request, timeout)
      stop(client)
      result
    end
  end

  @doc "Stops a client or a server. Does nothing if it has already ended."
  @spec stop(pid()) :: :ok
  def stop(pid) do
    GenServer.stop(pid)
  catch
    :exit, _reason -> :ok
  end

  def start_link(service, type, text, opts) do
    opts = Situ.Options.validate!(opts, Zenoh.options())

    with {:ok, service_info} <- describe_service(service, type, text),
         {:ok, program} <- Zenoh.find_program(),
         do:
           GenServer.start_link(
             __MODULE__,
             Map.merge(service_info, %{opts: opts, program: program})
           )
  end

  @doc "Returns the name, types and hash of a service, which its client and server share."
  @spec describe_service(String.t(), String.t(), String.t()) :: {:ok, map()} | {:error, Error.t()}
  def describe_service(service, type, text) do
    with {:ok, type} <- type_name(type),
         {:ok, definition} <- Definition.parse_service(type, text, :ros2) do
      name = "/" <> String.trim_leading(service, "/")
      hash = TypeHash.hash_service(type, definition)
      {:ok, %{name: name, type: type, definition: definition, hash: hash}}
    else
      {:error, why} ->
        {:error,
         Error.new(:bad_definition, "the definition of #{type} is invalid",
           why: why,
           fix: "give the type as \"package/srv/Name\" and the text of its .srv file"
         )}
    end
  end

  defp type_name(type) do
    if Regex.match?(~r/\A\w+\/(srv\/)?\w+\z/, type),
      do: {:ok, Definition.strip_kind(type)},
      else: {:error, "#{inspect(type)} is not a type name"}
  end

  @spec send_request(pid(), map(), pos_integer()) :: {:ok, map()} | {:error, Error.t()}
  def send_request(client, request, timeout),
    do: GenServer.call(client, {:ask, request, timeout}, :infinity)

  @impl true
  def init(service_info) do
    Process.flag(:trap_exit, true)
    port = Zenoh.open(service_info.program, service_info.opts[:router])
    initial = %{port: port, up?: false, unsent: [], requests: %{}, next: @first_id, sequence: 0}
    gid = :crypto.strong_rand_bytes(16)

    {:ok,
     service_info
     |> Map.merge(initial)
     |> Map.merge(%{node: Zenoh.node_name(service_info.opts), gid: gid})}
  end

  @impl true
  def handle_call({:ask, request, timeout}, from, state) do
    case Wire.encode(state.definition.request, request, :cdr) do
      {:ok, bytes} ->
        {:noreply, schedule_request(state, from, bytes, timeout)}

      {:error, why} ->
        title = "a request of #{state.name} cannot be written"
        {:reply, {:error, Error.new(:not_writable, title, why: why)}, state}
    end
  end

  defp schedule_request(%{next: id} = state, from, bytes, timeout) do
    timer = Process.send_after(self(), {:late, id, timeout}, timeout)
    next = if id == @last_id, do: @first_id, else: id + 1
    state = %{state | requests: Map.put(state.requests, id, {from, timer}), next: next}

    if state.up?,
      do: send_query(state, {id, bytes, timeout}),
      else: %{state | unsent: [{id, bytes, timeout} | state.unsent]}
  end

  # Zenoh waits a little longer than the caller, so that the caller's timer decides.
  defp send_query(%{opts: opts} = state, {id, bytes, timeout}) do
    state = %{state | sequence: state.sequence + 1}
    key = Keys.service_key(opts[:domain], state.name, state.type, state.hash)
    attachment = Keys.build_attachment(state.sequence, System.os_time(:nanosecond), state.gid)
    Zenoh.send_query(state.port, id, key, attachment, bytes, timeout + 1_000)
    state
  end

  @impl true
  def handle_info({port, {:data, frame}}, %{port: port} = state),
    do: {:noreply, frame |> Zenoh.parse_frame() |> handle_frame(state)}

  def handle_info({port, {:exit_status, status}}, %{port: port} = state) do
    error = Error.new(:ros_unreachable, "zenoh_port ended with status #{status}")
    for {_id, {from, _timer}} <- state.requests, do: GenServer.reply(from, {:error, error})
    {:stop, :normal, %{state | port: nil, requests: %{}}}
  end

  def handle_info({:late, id, timeout}, state) do
    {title, fix} =
      if state.up?,
        do:
          {"the service #{state.name} did not respond",
           "give it more time with `timeout:`, or check its server"},
        else:
          {"no router at #{state.opts[:router]}",
           "start `rmw_zenohd`, or name another router with `router:`"}

    error = Error.new(:ros_unreachable, title, why: "after #{timeout} ms", fix: fix)
    {:noreply, reply_to_caller(state, id, {:error, error})}
  end

  # The port exits when it is closed. If the process that started the client exits, the client exits too.
  def handle_info({:EXIT, from, reason}, state) when is_pid(from), do: {:stop, reason, state}
  def handle_info(_other, state), do: {:noreply, state}

  defp handle_frame({:open, session}, %{opts: opts, port: port} = state) do
    service_info = {state.name, state.type, state.hash, nil}
    Zenoh.declare_token(port, @node_id, Keys.node_token(opts[:domain], session, state.node))

    Zenoh.declare_token(
      port,
      @token_id,
      Keys.endpoint_token(:client, opts[:domain], session, state.node, service_info)
    )

    unsent = Enum.reverse(state.unsent)
    Enum.reduce(unsent, %{state | up?: true, unsent: []}, &send_query(&2, &1))
  end

  defp handle_frame({:answer, id, _attachment, payload}, state) do
    result =
      with {:error, why} <- Wire.decode(state.definition.response, payload, :cdr),
           do: {:error, refused_error("the response of #{state.name} cannot be decoded", why)}

    reply_to_caller(state, id, result)
  end

  defp handle_frame({:refusal, id, why}, state),
    do:
      reply_to_caller(
        state,
        id,
        {:error, refused_error("the service #{state.name} refused the call", printable_text(why))}
      )

  # This frame ends a query. If the request is still open, no server has replied.
  defp handle_frame({:query_end, id}, state) do
    error =
      Error.new(:ros_refused, "no server offers the service #{state.name}",
        why: "the client uses #{state.type}, #{state.hash}",
        fix: "start the server, or correct the definition: both sides must use the same type"
      )

    reply_to_caller(state, id, {:error, error})
  end

  defp handle_frame({:trouble, id, why}, state),
    do:
      reply_to_caller(
        state,
        id,
        {:error, refused_error("Zenoh cannot call #{state.name}", printable_text(why))}
      )

  defp handle_frame(_other, state), do: state

  defp refused_error(title, why), do: Error.new(:ros_refused, title, why: why)
  defp printable_text(text), do: if(String.valid?(text), do: text, else: inspect(text, limit: 50))

  defp reply_to_caller(state, id, result) do
    case Map.pop(state.requests, id) do
      {nil, _} ->
        state

      {{from, timer}, requests} ->
        Process.cancel_timer(timer)
        GenServer.reply(from, result)
        %{state | requests: requests}
    end
  end

  @impl true
  def terminate(_reason, state), do: Zenoh.close(state.port)
end
