defmodule Situ.Live.Yaws.Dispatch do
  @moduledoc false
  # Yaws calls this module, in the process of the connection, with each request whose head has been read. It builds a
  # `Situ.Live.Request`, which `Situ.Live.Adapter` serves through the callbacks. `:done` keeps the connection, `:closed`
  # ends it.
  # See docs/adr/0070-yaws-is-embedded-behind-its-dispatch-module.md.
  @behaviour Situ.Live.Adapter
  require Record
  alias Situ.Live.{Adapter, Endpoint, Request, Response}
  alias Situ.Live.Yaws.ResponseWriter

  @compile {:no_warn_undefined, [:yaws_api, :yaws_websockets]}

  @include "yaws/include/yaws_api.hrl"
  Record.defrecordp(:arg, Record.extract(:arg, from_lib: @include))
  @fields Record.extract(:headers, from_lib: @include)
  Record.defrecordp(:headers, @fields)
  Record.defrecordp(:http_request, Record.extract(:http_request, from_lib: @include))

  @chunk_bytes 65_536

  # The heap limit for reading a head (`Situ.Live.Yaws`) does not apply to the handler.
  def dispatch(arg(opaque: ref) = arg) do
    limit = Process.flag(:max_heap_size, 0)

    try do
      case Endpoint.fetch_config(ref) do
        {:ok, config} -> dispatch_request(arg, config)
        :error -> :closed
      end
    after
      restore_heap_limit(limit)
    end
  end

  # The handler's garbage must not count against the next head.
  defp restore_heap_limit(%{size: size} = limit) do
    {:total_heap_size, heap_size} = Process.info(self(), :total_heap_size)
    if size > 0 and heap_size > div(size, 8), do: :erlang.garbage_collect()
    Process.flag(:max_heap_size, limit)
  end

  defp dispatch_request(arg, config) do
    case build_request(arg, config) do
      {:ok, request} -> Adapter.serve_request(__MODULE__, arg, config, request)
      {:error, status} -> send_response(arg, config, %Request{}, {Response.error(status), false})
    end
  end

  @impl true
  def send_response(arg(clisock: socket, req: req), config, request, {response, body_read?}) do
    http_request(version: version) = req
    keep? = body_read? and keep_alive?(version, request)
    ResponseWriter.write_response(socket, config, request, response, keep?)
  end

  @impl true
  def upgrade_connection(arg, connection, max_frame) do
    options = [
      callback: {:basic, connection},
      max_frame_size: max_frame,
      max_message_size: max_frame,
      close_if_unmasked: true
    ]

    # Passes the connection to a new process and ends this one.
    :yaws_websockets.start(arg, Situ.Live.Yaws.WebSocket, options)
  end

  # -- reading

  defp build_request(arg(headers: headers, req: req, client_ip_port: peer), config) do
    http_request(method: method, path: path) = req

    case path do
      {:abs_path, target} ->
        fields = [scheme: config.scheme, peer: peer, endpoint: config.ref]

        case Request.new(to_string(method), to_binary(target), header_map(headers), fields) do
          {:ok, request} -> {:ok, request}
          {:error, :bad_request} -> {:error, 400}
        end

      _ ->
        {:error, 400}
    end
  end

  @header_fields Keyword.keys(@fields) -- [:other, :cookie, :authorization, :host]

  defp header_map(
         headers(other: other, cookie: cookies, authorization: auth, host: host) = record
       ) do
    values = headers(record)

    known =
      for field <- @header_fields, (value = values[field]) not in [nil, :undefined], into: %{} do
        {field |> Atom.to_string() |> String.replace("_", "-"), to_binary(value)}
      end

    others =
      for {:http_header, _, name, _, value} <- other, into: known do
        {name |> to_string() |> String.downcase(), to_binary(value)}
      end

    others
    |> put_present(
      "cookie",
      if(cookies == [], do: nil, else: cookies |> Enum.map(&to_binary/1) |> Enum.join("; "))
    )
    |> put_present("authorization", authorization_value(auth))
    |> put_present("host", host_value(host))
  end

  defp put_present(map, _name, nil), do: map
  defp put_present(map, name, value), do: Map.put(map, name, value)

  defp authorization_value({_user, _password, original}), do: to_binary(original)
  defp authorization_value(missing) when missing in [nil, :undefined], do: nil
  defp authorization_value(value), do: to_binary(value)

  # If there are several host headers, none of them is used.
  defp host_value(missing) when missing in [nil, :undefined], do: nil
  defp host_value({_several}), do: ""
  defp host_value(host), do: to_binary(host)

  defp to_binary(value) when is_binary(value), do: value
  defp to_binary(value), do: :erlang.iolist_to_binary(value)

  defp keep_alive?(version, request) do
    connection = request |> Request.get_header("connection") |> to_string() |> String.downcase()
    version == {1, 1} and connection != "close"
  end

  @impl true
  def read_body(arg(clisock: socket) = arg, config, request, length) do
    expect = request |> Request.get_header("expect") |> to_string() |> String.downcase()
    if expect == "100-continue", do: ResponseWriter.send_continue(socket)
    deadline = System.monotonic_time(:millisecond) + config.body_ms

    with {:ok, body} <- read_chunks(socket, length, deadline, []), do: {:ok, body, arg}
  end

  # The deadline applies to the whole body, so that a client cannot hold the connection by sending a byte now and then.
  defp read_chunks(_socket, 0, _deadline, acc),
    do: {:ok, acc |> Enum.reverse() |> IO.iodata_to_binary()}

  defp read_chunks(socket, length, deadline, acc) do
    remaining_ms = deadline - System.monotonic_time(:millisecond)

    case remaining_ms > 0 and receive_bytes(socket, min(length, @chunk_bytes), remaining_ms) do
      {:ok, bytes} -> read_chunks(socket, length - byte_size(bytes), deadline, [bytes | acc])
      _ -> {:error, 408}
    end
  end

  defp receive_bytes({:ssl, socket}, n, timeout_ms), do: :ssl.recv(socket, n, timeout_ms)
  defp receive_bytes(socket, n, timeout_ms), do: :gen_tcp.recv(socket, n, timeout_ms)
end
