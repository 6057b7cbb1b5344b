defmodule Situ.Link.Nats.DialerTest do
  use ExUnit.Case, async: true

  alias Situ.Link.Nats.Dialer

  @usable ~s(INFO {"version":"2.10.0","jetstream":true}\r\n)
  @refused "-ERR 'Authorization Violation'\r\n"

  # The bytes of the server, the options of the caller, and the code of the error.
  @failures [
    {"HTTP/1.1 400 Bad Request\r\n", [], :log_away},
    {~s(INFO {"version":"2.8.4"}\r\n), [], :old_server},
    {~s(INFO {"version":"2.10.0"}\r\n), [], :no_jetstream},
    {~s(INFO {"version":"2.10.0","jetstream":true,"tls_required":true}\r\n), [], :tls_required},
    {@usable, [tls: []], :no_tls},
    {~s(INFO {"version":"2.10.0","jetstream":true,"tls_available":true}\r\n), [tls: []],
     :tls_failed},
    {@usable <> @refused, [], :refused_login},
    {@usable <> "???\r\n", [], :log_away}
  ]

  for {{sent, opts, code}, i} <- Enum.with_index(@failures) do
    test "an attempt that fails with #{code} leaves no socket open (#{i})" do
      {:ok, listener} = :gen_tcp.listen(0, [:binary, active: false, ip: {127, 0, 0, 1}])
      {:ok, port} = :inet.port(listener)

      server =
        Task.async(fn ->
          {:ok, socket} = :gen_tcp.accept(listener)
          :ok = :gen_tcp.send(socket, unquote(sent))
          read_until_closed(socket, unquote(code))
        end)

      assert {:error, %{code: unquote(code)}} = Dialer.connect({"127.0.0.1", port}, unquote(opts))

      # The calling process is still alive, so the socket was not closed by its exit.
      assert Task.await(server, 60_000) in [:closed, :econnreset]
    end
  end

  defp read_until_closed(socket, code) do
    case :gen_tcp.recv(socket, 0, 30_000) do
      # The response to the first record of the handshake is not TLS.
      {:ok, _bytes} when code == :tls_failed ->
        _ = :gen_tcp.send(socket, "no TLS\r\n")
        read_until_closed(socket, :answered)

      {:ok, _bytes} ->
        read_until_closed(socket, code)

      {:error, reason} ->
        reason
    end
  end
end
