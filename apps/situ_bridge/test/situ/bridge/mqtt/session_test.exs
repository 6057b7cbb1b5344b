defmodule Situ.Bridge.Mqtt.SessionTest do
  # A broker of this test, so that it can refuse, forget and repeat.
  use ExUnit.Case, async: true
  alias Situ.Bridge.Mqtt
  alias Situ.Bridge.Mqtt.{Message, Reason, Subscription, Wire}
  doctest Reason

  @accepted_4 <<0x20, 2, 0, 0>>
  @accepted_5 <<0x20, 3, 0, 0, 0>>
  @resumed_5 <<0x20, 3, 1, 0, 0>>

  setup do
    {:ok, listener} = :gen_tcp.listen(0, [:binary, ip: {127, 0, 0, 1}, active: false])
    {:ok, port} = :inet.port(listener)
    %{listener: listener, port: port}
  end

  test "uses MQTT 3.1.1 with a broker that refuses MQTT 5", %{listener: listener, port: port} do
    {:ok, pipeline} =
      Situ.Pipeline.start_link(fn p ->
        p
        |> Situ.from_enumerable([{1, "a"}])
        |> Mqtt.publish("127.0.0.1", "t", port: port, format: :raw, linger: 10_000)
      end)

    {socket, <<0x10, _, 4::16, "MQTT", 5, _::binary>>} = accept(listener)
    :gen_tcp.send(socket, <<0x20, 2, 0, 1>>)
    :gen_tcp.close(socket)
    {socket, <<0x10, _, 4::16, "MQTT", 4, _::binary>>} = accept(listener)
    :gen_tcp.send(socket, @accepted_4)
    assert {:ok, <<0x32, 6, 1::16, "t", 1::16, "a">>} = :gen_tcp.recv(socket, 0, 10_000)
    :gen_tcp.send(socket, <<0x40, 2, 1::16>>)
    assert {:ok, _} = Situ.Pipeline.await(pipeline)
  end

  test "repeats QoS 2 over connections, within the broker's limits", %{
    listener: listener,
    port: port
  } do
    {:ok, pipeline} =
      Situ.Pipeline.start_link(fn p ->
        p
        |> Situ.from_enumerable([{1, "a"}, {2, "b"}])
        |> Mqtt.publish("127.0.0.1", "t", port: port, format: :raw, qos: 2, linger: 10_000)
      end)

    {socket, _hello} = accept(listener)
    :gen_tcp.send(socket, <<0x20, 9, 0, 0, 6, 0x21, 1::16, 0x22, 5::16>>)
    {:publish, first} = receive_packet(socket)
    assert %{topic: "t", payload: "a", qos: 2, id: 1, properties: %{topic_alias: 1}} = first
    assert [{"situ-originating-time", "1"}] = first.properties.user_properties
    :gen_tcp.send(socket, <<0x50, 2, 1::16>>)
    assert {:ok, <<0x62, 2, 1::16>>} = :gen_tcp.recv(socket, 4, 10_000)
    :gen_tcp.close(socket)

    {socket, _hello} = accept(listener)
    :gen_tcp.send(socket, @resumed_5)
    assert {:ok, <<0x62, 2, 1::16>>} = :gen_tcp.recv(socket, 4, 10_000)
    :gen_tcp.send(socket, <<0x70, 2, 1::16>>)
    assert {:publish, %{topic: "t", payload: "b", id: 2}} = receive_packet(socket)
    :gen_tcp.send(socket, <<0x50, 2, 2::16, 0x70, 2, 2::16>>)
    assert {:ok, _} = Situ.Pipeline.await(pipeline)
  end

  test "a subscription knows messages of earlier connections, until the session is lost" do
    message = bytes(Wire.encode_publish("t", "x", version: 5, qos: 2, id: 7))
    {_, state} = Subscription.hello("h", 1, id: "a", topic: "t", qos: 2, version: nil)
    {:ok, [], subscribe, state} = Subscription.read(@accepted_5, state, 1_000)
    assert <<0x82, _::binary>> = subscribe
    {:ok, [], "", state} = Subscription.read(<<0x90, 4, 1::16, 0, 2>>, state, 1_000)
    {:ok, ["x"], <<0x50, 2, 7::16>>, state} = Subscription.read(message, state, 1_000)

    {_, resumed} = Subscription.resume("h", 1, state)
    assert {:ok, [], "", resumed} = Subscription.read(@resumed_5, resumed, 1_000)
    assert {:ok, [], <<0x50, 2, 7::16>>, resumed} = Subscription.read(message, resumed, 1_000)
    {:ok, [], <<0x70, 2, 7::16>>, resumed} = Subscription.read(<<0x62, 2, 7::16>>, resumed, 1_000)
    assert {:ok, ["x"], _, _} = Subscription.read(message, resumed, 1_000)

    {_, forgotten} = Subscription.resume("h", 1, state)
    {:ok, [], <<0x82, _::binary>>, forgotten} = Subscription.read(@accepted_5, forgotten, 1_000)
    assert {:ok, ["x"], _, _} = Subscription.read(message, forgotten, 1_000)
  end

  test "topics have aliases on one connection, and unknown ones are an error" do
    {_, state} = Subscription.hello("h", 1, id: "a", topic: "t", qos: 0, envelope: true)
    first = bytes(Wire.encode_publish("t/a", "1", version: 5, properties: [topic_alias: 3]))
    second = bytes(Wire.encode_publish("", "2", version: 5, properties: [topic_alias: 3]))
    {:ok, payloads, "", state} = Subscription.read(first <> second, state, 1_000)

    assert [%Message{topic: "t/a", payload: 1}, %Message{topic: "t/a", payload: 2}] =
             for({text, nil, complete} <- payloads, do: complete.(String.to_integer(text)))

    {_, resumed} = Subscription.resume("h", 1, state)

    assert {:error, "a message with an unknown topic alias"} =
             Subscription.read(second, resumed, 1_000)
  end

  test "rejects topics that are filters, and wills without a topic" do
    publish = fn topic, opts ->
      Situ.Pipeline.start_link(fn p ->
        p |> Situ.from_enumerable([]) |> Mqtt.publish("127.0.0.1", topic, opts)
      end)
    end

    Process.flag(:trap_exit, true)
    assert {:error, error} = publish.("a/#", [])
    assert inspect(error) =~ "invalid_topic"
    assert {:error, error} = publish.("a", will: [payload: "x"])
    assert inspect(error) =~ "topic"
  end

  defp bytes(iodata), do: IO.iodata_to_binary(iodata)

  # The broker's machine is gone: its connection is open, but nothing answers.
  test "connects again if the broker no longer answers pings", %{listener: listener, port: port} do
    me = self()

    {:ok, pipeline} =
      Situ.Pipeline.start_link(fn p ->
        p
        |> Mqtt.subscribe("127.0.0.1", "t", port: port, format: :raw, keep_alive: 1)
        |> Situ.each(&send(me, {:got, &1}))
      end)

    {socket, hello} = accept(listener)
    <<0x10, _, 4::16, "MQTT", 5, _flags, 1::16, _::binary>> = hello
    :gen_tcp.send(socket, @accepted_5)
    assert <<0x82, _::binary>> = receive_bytes(socket)
    :gen_tcp.send(socket, <<0x90, 4, 1::16, 0, 1>>)
    # While it answers, the connection stays.
    for _ <- 1..4 do
      assert receive_bytes(socket) == <<0xC0, 0>>
      :gen_tcp.send(socket, <<0xD0, 0>>)
    end

    {socket, _hello} = accept(listener)
    :gen_tcp.send(socket, @accepted_5)
    assert <<0x82, _::binary>> = receive_bytes(socket)
    :gen_tcp.send(socket, <<0x90, 4, 1::16, 0, 1, 0x30, 5, 1::16, "t", 0, "a">>)
    assert_receive {:got, "a"}, 10_000
    Situ.Pipeline.stop(pipeline)
  end

  test "sends messages again if the broker no longer answers", %{listener: listener, port: port} do
    {:ok, pipeline} =
      Situ.Pipeline.start_link(fn p ->
        p
        |> Situ.from_enumerable([{1, "a"}])
        |> Mqtt.publish("127.0.0.1", "t", port: port, format: :raw, keep_alive: 60, linger: 30_000)
      end)

    # The broker sets a shorter time than the client.
    {socket, _hello} = accept(listener)
    :gen_tcp.send(socket, <<0x20, 6, 0, 0, 3, 0x13, 1::16>>)
    assert {:publish, %{payload: "a", id: 1}} = receive_packet(socket)
    assert receive_bytes(socket) == <<0xC0, 0>>

    {socket, _hello} = accept(listener)
    :gen_tcp.send(socket, @accepted_5)
    assert {:publish, %{payload: "a", id: 1}} = receive_packet(socket)
    :gen_tcp.send(socket, <<0x40, 2, 1::16>>)
    assert {:ok, _} = Situ.Pipeline.await(pipeline)
  end

  defp receive_bytes(socket) do
    {:ok, bytes} = :gen_tcp.recv(socket, 0, 10_000)
    bytes
  end

  defp accept(listener) do
    {:ok, socket} = :gen_tcp.accept(listener, 10_000)
    {:ok, bytes} = :gen_tcp.recv(socket, 0, 10_000)
    {socket, bytes}
  end

  defp receive_packet(socket, bytes \\ "") do
    case Wire.parse_packet(bytes, 1_000, 5) do
      {:ok, packet, ""} ->
        packet

      :more ->
        {:ok, more} = :gen_tcp.recv(socket, 0, 10_000)
        receive_packet(socket, bytes <> more)
    end
  end
end
