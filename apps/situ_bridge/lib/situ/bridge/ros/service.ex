defmodule Situ.Bridge.Ros.Service do
  @moduledoc false
  # Calls a ROS service, and serves one with a process for each caller.
  use GenServer
  alias Situ.Bridge.Net.Listener
  alias Situ.Bridge.Ros.{Address, Definition, Registrar, TcpRos, Wire}
  alias Situ.Error

  @timeout 5_000
  @max_response 64 * 1024 * 1024

  def call(service, text, request, opts \\ []) do
    {timeout, opts} = Keyword.pop(opts, :timeout, @timeout)
    address = Address.new(opts)
    name = Address.resolve_name(service)

    with {:ok, definition} <- parse_definition(name, text),
         {:ok, bytes} <- encode_message(name, definition.request, request),
         {:ok, uri} <- Registrar.call_master(address, "lookupService", [address.node, name]),
         %URI{host: host, port: port} when is_binary(host) and is_integer(port) <- URI.parse(uri),
         {:ok, tcp} <- connect_to_server(host, port, timeout) do
      result = exchange_messages(tcp, bytes, header_fields(name, definition, address), timeout)
      :gen_tcp.close(tcp)
      decode_response(result, name, definition)
    else
      %URI{} -> {:error, refused_error(name, "the master returned a malformed address")}
      error -> error
    end
  end

  defp header_fields(name, definition, address),
    do: %{"callerid" => address.node, "service" => name, "md5sum" => definition.md5}

  defp connect_to_server(host, port, timeout) do
    with {:error, reason} <-
           :gen_tcp.connect(
             String.to_charlist(host),
             port,
             [:binary, active: false, nodelay: true],
             timeout
           ),
         do:
           {:error,
            Error.new(:ros_unreachable, "no response from #{host}:#{port}", why: inspect(reason))}
  end

  defp exchange_messages(tcp, bytes, header, timeout) do
    with :ok <- :gen_tcp.send(tcp, TcpRos.encode_header(header)),
         {:ok, %{} = peer_fields} <- read_header(tcp, "", timeout),
         nil <- peer_fields["error"] || TcpRos.find_mismatch(peer_fields, header),
         :ok <- :gen_tcp.send(tcp, TcpRos.frame(bytes, nil)),
         {:ok, <<ok>>} <- :gen_tcp.recv(tcp, 1, timeout),
         {:ok, response} <- read_frame(tcp, timeout) do
      if ok == 1, do: {:ok, response}, else: {:error, response}
    end
  end

  defp read_header(tcp, bytes, timeout) do
    case TcpRos.read_header(bytes) do
      {:ok, fields, ""} ->
        {:ok, fields}

      :more ->
        # Bytes after the header belong to a message, so exactly the header is read.
        missing = if byte_size(bytes) < 4, do: 4, else: :binary.decode_unsigned(bytes, :little)

        with {:ok, more} <- :gen_tcp.recv(tcp, missing, timeout),
             do: read_header(tcp, bytes <> more, timeout)

      {:error, why} ->
        why
    end
  end

  defp read_frame(tcp, timeout) do
    case :gen_tcp.recv(tcp, 4, timeout) do
      {:ok, <<0::32>>} -> {:ok, ""}
      {:ok, <<n::little-32>>} when n <= @max_response -> :gen_tcp.recv(tcp, n, timeout)
      {:ok, <<n::little-32>>} -> "the response has #{n} bytes, which is too large"
      error -> error
    end
  end

  defp decode_response({:ok, bytes}, name, definition) do
    with {:error, why} <- Wire.decode(definition.response, bytes, :ros1),
         do: {:error, refused_error(name, why)}
  end

  defp decode_response({:error, why}, name, _) when is_binary(why),
    do: {:error, refused_error(name, printable_text(why))}

  defp decode_response(why, name, _) when is_binary(why), do: {:error, refused_error(name, why)}

  defp decode_response({:error, reason}, name, _),
    do:
      {:error,
       Error.new(:ros_unreachable, "the service #{name} is not responding", why: inspect(reason))}

  defp printable_text(text), do: if(String.valid?(text), do: text, else: inspect(text, limit: 50))

  defp refused_error(name, why),
    do: Error.new(:ros_refused, "the service #{name} refused the call", why: why)

  defp parse_definition(name, text) do
    with {:error, why} <- Definition.parse_service(name, text),
         do:
           {:error, Error.new(:bad_definition, "the definition of #{name} is invalid", why: why)}
  end

  defp encode_message(name, definition, message) do
    with {:error, why} <- Wire.encode(definition, message, :ros1),
         do:
           {:error, Error.new(:not_writable, "a message of #{name} cannot be written", why: why)}
  end

  # Serving

  def serve(service, type, text, fun, opts \\ []) do
    address = Address.new(opts)
    name = Address.resolve_name(service)

    with {:ok, definition} <- parse_definition(type, text),
         {:ok, listener} <- Listener.listen(Address.listen_interface(address), 0),
         uri = "rosrpc://#{address.host}:#{Listener.port(listener)}",
         {:ok, _} <-
           Registrar.call_master(address, "registerService", [address.node, name, uri, uri]) do
      header =
        Map.merge(header_fields(name, definition, address), %{
          "type" => type,
          "request_type" => type <> "Request",
          "response_type" => type <> "Response"
        })

      state = %{
        listener: listener,
        address: address,
        name: name,
        uri: uri,
        header: header,
        definition: definition,
        fun: fun,
        callers: MapSet.new(),
        acceptor: nil
      }

      {:ok, server} = GenServer.start_link(__MODULE__, state)
      :ok = :gen_tcp.controlling_process(listener, server)
      send(server, :begin)
      {:ok, server}
    end
  end

  def stop(server), do: GenServer.stop(server)

  @impl true
  def init(state) do
    Process.flag(:trap_exit, true)
    {:ok, state}
  end

  @impl true
  def handle_call(:adopt, _from, state) do
    caller = spawn_link(fn -> serve_caller(state) end)
    {:reply, caller, %{state | callers: MapSet.put(state.callers, caller)}}
  end

  @impl true
  def handle_info(:begin, state),
    do: {:noreply, %{state | acceptor: Listener.start_acceptor(state.listener, self())}}

  def handle_info({:EXIT, pid, reason}, %{acceptor: pid} = state), do: {:stop, reason, state}

  def handle_info({:EXIT, pid, reason}, state) do
    if pid in state.callers,
      do: {:noreply, %{state | callers: MapSet.delete(state.callers, pid)}},
      else: {:stop, reason, state}
  end

  @impl true
  def terminate(_reason, state) do
    Registrar.call_master(state.address, "unregisterService", [
      state.address.node,
      state.name,
      state.uri
    ])

    for caller <- state.callers, do: Process.exit(caller, :kill)
    :gen_tcp.close(state.listener)
  end

  # Runs in a caller's process: reads its header, then handles one request after another.
  defp serve_caller(state) do
    receive do
      {:adopt, tcp} -> greet_caller(tcp, read_header(tcp, "", @timeout), state)
    after
      @timeout -> :ok
    end
  end

  defp greet_caller(tcp, {:ok, peer_fields}, state) do
    case TcpRos.find_mismatch(peer_fields, state.header) do
      nil ->
        :gen_tcp.send(tcp, TcpRos.encode_header(state.header))
        # A probe only checks whether the service exists.
        unless peer_fields["probe"] == "1", do: serve_requests(tcp, state)

      why ->
        :gen_tcp.send(tcp, TcpRos.encode_header(%{"error" => why}))
    end
  end

  defp greet_caller(_tcp, _other, _state), do: :ok

  defp serve_requests(tcp, state) do
    with {:ok, bytes} <- read_frame(tcp, :infinity),
         :ok <- :gen_tcp.send(tcp, build_response(bytes, state)),
         do: serve_requests(tcp, state)
  end

  defp build_response(bytes, state) do
    with {:ok, request} <- Wire.decode(state.definition.request, bytes, :ros1),
         {:ok, response} <- state.fun.(request),
         {:ok, response} <- Wire.encode(state.definition.response, response, :ros1) do
      [1, TcpRos.frame(response, nil)]
    else
      {:error, why} -> [0, TcpRos.frame(to_string(why), nil)]
    end
  rescue
    error -> [0, TcpRos.frame(Exception.message(error), nil)]
  end
end
