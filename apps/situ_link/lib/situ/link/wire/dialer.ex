defmodule Situ.Link.Wire.Dialer do
  @moduledoc false
  # Connects to an address and logs in. This runs in a separate process, since name lookup, TLS and an unresponsive
  # server may each take seconds.
  alias Situ.{Error, Link}
  alias Situ.Link.Wire.{Frame, Handshake, Socket}

  @timeout_ms 5_000
  # The longest frame that a server may send: a part of a batch, or a catalogue.
  @max_bytes 64 * 1024 * 1024

  @doc "Returns the size in bytes of the longest frame accepted from a server."
  @spec max_bytes() :: pos_integer()
  def max_bytes, do: @max_bytes

  @doc "Tries to connect once. The caller receives `{:dialed, dialer, {:ok, socket, welcome} | {:error, error}}`."
  @spec start_dialer(Link.Address.t(), map()) :: pid()
  def start_dialer(address, opts) do
    caller = self()

    spawn_link(fn ->
      case connect_and_login(address, opts) do
        {:ok, socket, welcome} ->
          case Socket.set_owner(socket, caller) do
            :ok -> send(caller, {:dialed, self(), {:ok, socket, welcome}})
            {:error, _} -> send(caller, {:dialed, self(), {:error, connection_ended_error()}})
          end

        {:error, error} ->
          send(caller, {:dialed, self(), {:error, error}})
      end
    end)
  end

  @doc "Returns the names of all recordings of a server. The name in the address is ignored."
  @spec list_recordings(Link.Address.t(), map()) :: {:ok, [String.t()]} | {:error, Error.t()}
  def list_recordings(address, opts) do
    with {:ok, socket, welcome} <- connect_and_login(address, Map.put(opts, :list, true)) do
      Socket.close(socket)
      {:ok, for(name <- List.wrap(welcome["names"]), is_binary(name), do: name)}
    end
  end

  defp connect_and_login(address, opts) do
    with {:ok, resolved} <- Link.Address.resolve(address),
         {:ok, socket} <- Socket.connect(resolved, opts.tls, @timeout_ms) do
      with {:error, error} <- log_in(socket, resolved, opts) do
        Socket.close(socket)
        {:error, error}
      end
    end
  end

  defp log_in(socket, address, opts) do
    nonce = Handshake.new_nonce()

    with :ok <- Socket.send(socket, Frame.encode(Handshake.build_hello(nonce))),
         {:ok, {:hello, version, oldest, server_nonce}} <- receive_frame(socket),
         {:ok, _version} <- Handshake.check_version(version, oldest),
         proof = Handshake.build_proof(opts.token, :client, server_nonce, nonce),
         :ok <- Socket.send(socket, Frame.encode({:login, proof, login_request(address, opts)})),
         {:ok, {:welcome, reply, map}} <- receive_frame(socket),
         {:proved, true} <-
           {:proved, Handshake.valid_proof?(opts.token, :server, server_nonce, nonce, reply)} do
      {:ok, socket, map}
    else
      {:proved, false} ->
        {:error,
         Error.new(:wrong_token, "the server of the link has a different token",
           why: "its proof does not match the token given here",
           fix: "check that this is the right server, and give both sides the same `token:`"
         )}

      {:ok, {:refused, map}} ->
        {:error, Handshake.error_from_map(map)}

      {:ok, frame} ->
        {:error,
         wrong_protocol_error("received the frame #{elem(frame, 0)} instead of a greeting")}

      {:error, %Error{} = error} ->
        {:error, error}

      {:error, reason} when is_binary(reason) ->
        {:error, wrong_protocol_error(reason)}

      {:error, reason} ->
        {:error, wrong_protocol_error(Socket.reason_text(reason))}
    end
  end

  defp login_request(_address, %{list: true}), do: %{"list" => true}
  defp login_request(address, _opts), do: %{"name" => address.name}

  defp receive_frame(socket) do
    with {:ok, body} <- Socket.receive(socket, @timeout_ms), do: Frame.decode(body)
  end

  defp wrong_protocol_error(why) do
    Error.new(:no_link, "the program at that port does not speak the link protocol",
      why: why,
      fix: "check host and port, and use TLS (situs://) on both sides or on neither"
    )
  end

  defp connection_ended_error,
    do: Error.new(:unreachable, "the connection was closed right after the login")
end
