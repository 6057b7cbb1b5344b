defmodule Situ.Bridge.Net.ClientSocketTest do
  use ExUnit.Case, async: true
  alias Situ.Bridge.Net.ClientSocket

  @moduletag :tmp_dir
  @moduletag :capture_log

  # Creates a certificate authority, and a server with its certificate for "broker".
  setup %{tmp_dir: dir} do
    {:ok, _} = Application.ensure_all_started(:ssl)

    sans = [
      {:Extension, {2, 5, 29, 17}, false, [{:dNSName, 'broker'}, {:iPAddress, <<127, 0, 0, 1>>}]}
    ]

    # The curve P-256.
    own = [key: {:namedCurve, {1, 2, 840, 10_045, 3, 1, 7}}, digest: :sha256]

    made = fn names ->
      :public_key.pkix_test_data(%{
        server_chain: %{
          root: own,
          intermediates: [],
          peer: own ++ [extensions: names]
        },
        client_chain: %{root: own, intermediates: [], peer: own}
      })
    end

    %{server_config: server, client_config: client} = made.(sans)
    ca = Path.join(dir, "ca.pem")
    pem = for der <- client[:cacerts], do: {:Certificate, der, :not_encrypted}
    File.write!(ca, :public_key.pem_encode(pem))
    %{client_config: other} = made.([])
    pem = for der <- other[:cacerts], do: {:Certificate, der, :not_encrypted}
    File.write!(Path.join(dir, "other.pem"), :public_key.pem_encode(pem))

    {:ok, listener} =
      :ssl.listen(0, [:binary, active: false, reuseaddr: true] ++ Keyword.delete(server, :verify))

    {:ok, {_, port}} = :ssl.sockname(listener)
    on_exit(fn -> :ssl.close(listener) end)
    %{ca: ca, other: Path.join(dir, "other.pem"), listener: listener, port: port}
  end

  # Accepts one connection and echoes the first message.
  defp serve(listener) do
    Task.start_link(fn ->
      {:ok, transport} = :ssl.transport_accept(listener, 10_000)

      with {:ok, socket} <- :ssl.handshake(transport, 10_000),
           {:ok, said} <- :ssl.recv(socket, 5, 10_000),
           do: :ssl.send(socket, "you said " <> said)
    end)
  end

  test "describes why a connection failed" do
    for {reason, text} <- [
          {:econnrefused, "connection refused"},
          {:etimedout, "the other machine no longer answers"},
          {{:tls_alert, {:unknown_ca, 'unknown authority'}}, "TLS: unknown authority"},
          {:unexpected, ":unexpected"},
          {"a sentence", "a sentence"}
        ],
        do: assert(ClientSocket.describe_reason(reason) == text)
  end

  test "connects by address and by name with a custom certificate authority", context do
    for tls <- [[authorities: context.ca], [authorities: context.ca, name: "broker"]] do
      serve(context.listener)

      assert {:ok, {:ssl, _} = dialled} =
               ClientSocket.connect("127.0.0.1", context.port, tls, nodelay: true)

      :ok = ClientSocket.send_bytes(dialled, "hello")
      assert collected(dialled, "") == "you said hello"
      ClientSocket.close(dialled)
    end
  end

  defp collected(dialled, text) do
    receive do
      message ->
        case ClientSocket.match_message(message, dialled) do
          {:ok, bytes} ->
            ClientSocket.activate_once(dialled)

            if text <> bytes == "you said hello",
              do: text <> bytes,
              else: collected(dialled, text <> bytes)

          :other ->
            collected(dialled, text)
        end
    after
      10_000 -> text
    end
  end

  test "refuses another authority, another name and a missing authority", context do
    for tls <- [
          [authorities: context.other],
          [authorities: context.ca, name: "elsewhere"],
          true
        ] do
      serve(context.listener)
      assert {:error, {:tls_alert, _}} = ClientSocket.connect("127.0.0.1", context.port, tls, [])
    end

    assert {:error, "/nowhere.pem" <> _} =
             ClientSocket.connect("127.0.0.1", context.port, [authorities: "/nowhere.pem"], [])

    assert {:error, "tls: has no option :verify" <> _} =
             ClientSocket.connect("127.0.0.1", 1, [verify: false], [])
  end

  test "connects without TLS" do
    {:ok, listener} = :gen_tcp.listen(0, [:binary, active: false, ip: {127, 0, 0, 1}])
    {:ok, port} = :inet.port(listener)
    {:ok, {:gen_tcp, _} = dialled} = ClientSocket.connect("127.0.0.1", port, false, [])
    {:ok, socket} = :gen_tcp.accept(listener)
    :ok = :gen_tcp.send(socket, "x")
    assert_receive message = {:tcp, _, "x"}
    assert ClientSocket.match_message(message, dialled) == {:ok, "x"}
    :gen_tcp.close(socket)
    :ok = ClientSocket.activate_once(dialled)
    assert_receive message = {:tcp_closed, _}
    assert ClientSocket.match_message(message, dialled) == {:disconnected, :closed}
    assert ClientSocket.match_message(:something, nil) == :other
  end
end
