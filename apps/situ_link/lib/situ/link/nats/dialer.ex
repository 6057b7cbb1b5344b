defmodule Situ.Link.Nats.Dialer do
  @moduledoc false
  # Connects to one NATS server: greeting, TLS, login and subscriptions.
  alias Situ.{Error, JSON}
  alias Situ.Link.Nats.Protocol
  alias Situ.Link.ServerName

  @max_frame 65_536
  @timeout_ms 3_000

  @type server :: {String.t(), :inet.port_number()}
  @type dialed :: %{
          transport: :gen_tcp | :ssl,
          socket: term(),
          inbox: String.t(),
          info: map(),
          rest: binary()
        }

  @doc "Connects to a server and logs in. `opts` are those of the connection: `login`, `tls`, `subjects`, `jetstream`."
  @spec connect(server(), keyword()) :: {:ok, dialed()} | {:error, Error.t()}
  def connect({host, port} = server, opts) do
    state = %{server: server, opts: opts, transport: nil, socket: nil}

    # By default, each read takes at most 1,460 bytes.
    options = [
      :binary,
      active: false,
      buffer: 65_536,
      nodelay: true,
      keepalive: true,
      send_timeout: 5_000,
      send_timeout_close: true
    ]

    with {:ok, socket} <-
           check_connected(:gen_tcp.connect(to_charlist(host), port, options, @timeout_ms), state),
         {:ok, info, rest} <- socket |> read_greeting("", state) |> or_close(:gen_tcp, socket),
         :ok <- info |> check_server(state) |> or_close(:gen_tcp, socket),
         {:ok, transport, socket} <-
           socket |> secure_socket(info, state) |> or_close(:gen_tcp, socket),
         inbox = "_INBOX." <> Base.encode16(:crypto.strong_rand_bytes(10)),
         :ok <- transport |> send_connect(socket, inbox, state) |> or_close(transport, socket),
         state = %{state | transport: transport, socket: socket},
         {:ok, rest} <- state |> await_pong(rest) |> or_close(transport, socket) do
      {:ok, %{transport: transport, socket: socket, inbox: inbox, info: info, rest: rest}}
    end
  end

  # The caller retries repeatedly, so a failed attempt must not leave its socket open.
  defp or_close({:error, _} = error, transport, socket) do
    _ = transport.close(socket)
    error
  end

  defp or_close(result, _transport, _socket), do: result

  @doc "Formats the address of a server as `host:port`."
  @spec format_server(server()) :: String.t()
  def format_server({host, port}), do: "#{host}:#{port}"

  defp check_connected({:ok, socket}, _state), do: {:ok, socket}

  defp check_connected({:error, reason}, state) do
    {:error,
     Error.new(
       :log_away,
       "cannot connect to a NATS server at #{format_server(state.server)}: #{reason_text(reason)}",
       fix: "start nats-server with JetStream (nats-server -js), or correct the address"
     )}
  end

  defp read_greeting(socket, buffer, state) do
    with {:ok, bytes} <- :gen_tcp.recv(socket, 0, @timeout_ms),
         {:ok, {:info, json}, rest} <- Protocol.parse_frame(buffer <> bytes, @max_frame),
         {:ok, info} when is_map(info) <- JSON.decode(json) do
      {:ok, info, rest}
    else
      :more when byte_size(buffer) < @max_frame ->
        read_greeting(socket, buffer, state)

      _ ->
        {:error,
         Error.new(:log_away, "#{format_server(state.server)} does not speak the NATS protocol")}
    end
  end

  defp check_server(info, state) do
    version = to_string(info["version"])

    cond do
      too_old?(version) ->
        {:error,
         Error.new(
           :old_server,
           "the NATS server at #{format_server(state.server)} has version #{version}",
           fix: "use version 2.9 or newer"
         )}

      info["jetstream"] != true and state.opts[:jetstream] != false ->
        {:error,
         Error.new(
           :no_jetstream,
           "the NATS server at #{format_server(state.server)} does not store messages",
           why: "JetStream is off",
           fix: "start it with -js and a folder: nats-server -js -sd FOLDER"
         )}

      true ->
        :ok
    end
  end

  defp too_old?(version) do
    case Version.parse(version) do
      {:ok, version} -> Version.compare(version, "2.9.0") == :lt
      :error -> true
    end
  end

  defp secure_socket(socket, info, state) do
    tls = state.opts[:tls]

    cond do
      tls != nil and not (info["tls_required"] == true or info["tls_available"] == true) ->
        {:error,
         Error.new(
           :no_tls,
           "the NATS server at #{format_server(state.server)} does not support TLS",
           why:
             "TLS is configured for it, and without TLS others on the network could read the log",
           fix:
             "start it with the configuration of `situ cluster init` (nats-server -c nats-server.conf), or leave out" <>
               " tls: (--log-plain)"
         )}

      tls != nil ->
        # A node whose distribution uses TLS has loaded parts of ssl, but has not started the application.
        {:ok, _} = Application.ensure_all_started(:ssl)
        {host, _port} = state.server

        tls = Keyword.merge([verify: :verify_peer] ++ ServerName.tls_options(host), tls)

        check_upgrade(:ssl.connect(socket, tls, @timeout_ms), state)

      info["tls_required"] == true ->
        {:error,
         Error.new(
           :tls_required,
           "the NATS server at #{format_server(state.server)} requires TLS",
           fix:
             "give tls: [cacertfile: ...], or use the `situ cluster init` folder that the server was set up from"
         )}

      true ->
        {:ok, :gen_tcp, socket}
    end
  end

  defp check_upgrade({:ok, socket}, _state), do: {:ok, :ssl, socket}

  defp check_upgrade({:error, reason}, state) do
    {:error,
     Error.new(
       :tls_failed,
       "the TLS handshake with #{format_server(state.server)} failed: #{inspect(reason, limit: 8)}",
       fix: "check cacertfile:, certfile: and keyfile:"
     )}
  end

  defp send_connect(transport, socket, inbox, state) do
    # The login is a function, so that inspecting the process state does not print it.
    login = if state.opts[:login], do: state.opts[:login].(), else: %{}

    options =
      Map.merge(login, %{
        "verbose" => false,
        "pedantic" => false,
        "headers" => true,
        "no_responders" => true,
        "lang" => "elixir",
        "name" => "situ",
        "version" => "1"
      })

    subjects = Enum.with_index([inbox <> ".*" | state.opts[:subjects] || []], 1)
    subscriptions = for {subject, i} <- subjects, do: "SUB #{subject} #{i}\r\n"
    lines = ["CONNECT ", JSON.encode(options), "\r\n", subscriptions, "PING\r\n"]

    with {:error, reason} <- transport.send(socket, lines),
         do: check_connected({:error, reason}, state)
  end

  defp await_pong(state, buffer) do
    case Protocol.parse_frame(buffer, @max_frame) do
      {:ok, :pong, rest} ->
        {:ok, rest}

      {:ok, {:failure, text}, _rest} ->
        {:error,
         Error.new(:refused_login, "#{format_server(state.server)} rejected the login: #{text}",
           fix: "check the user and password, or the token"
         )}

      {:ok, _frame, rest} ->
        await_pong(state, rest)

      :more ->
        case state.transport.recv(state.socket, 0, @timeout_ms) do
          {:ok, bytes} -> await_pong(state, buffer <> bytes)
          {:error, reason} -> check_connected({:error, reason}, state)
        end

      {:error, _} ->
        {:error,
         Error.new(:log_away, "#{format_server(state.server)} does not speak the NATS protocol")}
    end
  end

  defp reason_text(:timeout), do: "no response within #{div(@timeout_ms, 1_000)} s"
  defp reason_text(:closed), do: "it closed the connection"
  defp reason_text(reason), do: to_string(:inet.format_error(reason))
end
