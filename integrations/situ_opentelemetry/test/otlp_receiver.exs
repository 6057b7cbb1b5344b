defmodule OtlpReceiver do
  # A receiver of OTLP over HTTP. It decodes each request and sends it to the processes that have subscribed.
  @messages %{
    "/v1/traces" => {:opentelemetry_exporter_trace_service_pb, :export_trace_service_request},
    "/v1/metrics" =>
      {:opentelemetry_exporter_metrics_service_pb, :export_metrics_service_request},
    "/v1/logs" => {:opentelemetry_exporter_logs_service_pb, :export_logs_service_request}
  }

  def start do
    {:ok, _} = Registry.start_link(keys: :duplicate, name: __MODULE__)

    {:ok, listener} =
      :gen_tcp.listen(0, [:binary, packet: :http_bin, active: false, reuseaddr: true])

    spawn_link(fn -> accept(listener) end)
    :inet.port(listener)
  end

  def subscribe, do: Registry.register(__MODULE__, :all, nil)

  defp accept(listener) do
    {:ok, socket} = :gen_tcp.accept(listener)
    pid = spawn(fn -> receive(do: (:ready -> serve(socket))) end)
    :ok = :gen_tcp.controlling_process(socket, pid)
    send(pid, :ready)
    accept(listener)
  end

  defp serve(socket) do
    with {:ok, {:http_request, :POST, {:abs_path, path}, _version}} <- :gen_tcp.recv(socket, 0) do
      size = read_size(socket, 0)
      :ok = :inet.setopts(socket, packet: :raw)
      {:ok, body} = :gen_tcp.recv(socket, size)
      {module, message} = Map.fetch!(@messages, path)
      decoded = module.decode_msg(body, message)
      Registry.dispatch(__MODULE__, :all, &for({pid, _} <- &1, do: send(pid, {path, decoded})))

      :gen_tcp.send(
        socket,
        "HTTP/1.1 200 OK\r\ncontent-type: application/x-protobuf\r\ncontent-length: 0\r\n\r\n"
      )

      :ok = :inet.setopts(socket, packet: :http_bin)
      serve(socket)
    end
  end

  defp read_size(socket, size) do
    case :gen_tcp.recv(socket, 0) do
      {:ok, {:http_header, _, :"Content-Length", _, value}} ->
        read_size(socket, String.to_integer(value))

      {:ok, {:http_header, _, _, _, _}} ->
        read_size(socket, size)

      {:ok, :http_eoh} ->
        size
    end
  end

  @doc "Returns the first item of any request so far, or of one that arrives, for which `fun` returns a true value."
  def await(path, fun, deadline \\ System.monotonic_time(:millisecond) + 20_000) do
    received = Process.get(path, [])

    case Enum.find(received, fun) do
      nil ->
        receive do
          {^path, request} ->
            Process.put(path, received ++ items(request))
            await(path, fun, deadline)
        after
          max(deadline - System.monotonic_time(:millisecond), 0) ->
            raise "nothing that matches has arrived at #{path}"
        end

      item ->
        item
    end
  end

  defp items(%{resource_spans: list}),
    do: for(r <- list, s <- r.scope_spans, span <- s.spans, do: span)

  defp items(%{resource_metrics: list}),
    do: for(r <- list, s <- r.scope_metrics, m <- s.metrics, do: m)

  defp items(%{resource_logs: list}),
    do: for(r <- list, s <- r.scope_logs, l <- s.log_records, do: l)

  def attributes(item) do
    for %{key: key, value: %{value: {_type, value}}} <- item.attributes,
        into: %{},
        do: {key, value}
  end
end
