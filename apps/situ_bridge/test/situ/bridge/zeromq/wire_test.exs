defmodule Situ.Bridge.ZeroMQ.WireTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Bridge.ZeroMQ.Wire

  @most 100_000

  defp bytes(iodata), do: IO.iodata_to_binary(iodata)

  test "completes the handshake of two compatible sides" do
    assert byte_size(Wire.greeting()) == 64
    assert Wire.parse_greeting(Wire.greeting() <> "rest") == {:ok, "rest"}
    assert Wire.parse_ready(bytes(Wire.encode_ready(:pub)), :sub, @most) == {:ok, ""}
    assert Wire.parse_ready(bytes(Wire.encode_ready(:push)), :pull, @most) == {:ok, ""}
    assert {:error, why} = Wire.parse_ready(bytes(Wire.encode_ready(:pub)), :pull, @most)
    assert why =~ "PUB"
  end

  test "rejects other peers with a reason" do
    assert {:error, _} = Wire.parse_greeting("GET / HTTP/1.1\r\n")

    assert {:error, why} =
             Wire.parse_greeting(<<0xFF, 0::64, 0x7F, 2, 0, "NULL", 0::128, 0, 0::248>>)

    assert why =~ "ZMTP 2"

    assert {:error, why} =
             Wire.parse_greeting(<<0xFF, 0::64, 0x7F, 3, 1, "CURVE", 0::120, 0, 0::248>>)

    assert why =~ "CURVE"
    assert Wire.parse_greeting(binary_part(Wire.greeting(), 0, 63)) == :more
  end

  property "reads messages wherever the bytes are split" do
    forall {messages, at} <- :proper_types.tuple([list(nonempty_list(binary())), integer(0, 200)]) do
      all = bytes(Enum.map(messages, &Wire.encode_message/1))
      at = min(at, byte_size(all))
      <<first::binary-size(at), second::binary>> = all
      {:ok, one, parts, rest} = Wire.parse_events(first, [], :pull, @most)
      {:ok, two, [], ""} = Wire.parse_events(rest <> second, parts, :pull, @most)
      assert one ++ two == Enum.map(messages, &{:message, &1})
    end
  end

  test "a publisher receives subscriptions as messages and as commands" do
    sent = [
      Wire.encode_subscription(:subscribe, "a"),
      Wire.encode_subscription(:unsubscribe, "a"),
      <<4, 11, 9, "SUBSCRIBE", "b">>
    ]

    assert Wire.parse_events(bytes(sent), [], :pub, @most) ==
             {:ok, [subscribe: "a", unsubscribe: "a", subscribe: "b"], [], ""}
  end

  test "rejects an oversized frame or message before it is complete" do
    assert {:error, _} = Wire.parse_events(<<2, 0xFFFFFFFFFFFFFFFF::64>>, [], :sub, @most)
    parts = for _ <- 1..10, do: <<1, 200, 0::1600>>
    assert {:error, _} = Wire.parse_events(bytes(parts), [], :sub, 1_000)
  end

  test "reads 20,000 mutated conversations as events or errors" do
    all =
      bytes([
        Wire.encode_message(["topic", String.duplicate("x", 300)]),
        Wire.encode_message(["t", "y"]),
        Wire.encode_subscription(:subscribe, "z")
      ])

    :rand.seed(:exsss, {1, 1, 1})

    for _ <- 1..20_000 do
      at = :rand.uniform(byte_size(all)) - 1
      <<before::binary-size(at), _, rest::binary>> = all

      case Wire.parse_events(
             before <> <<:rand.uniform(256) - 1>> <> rest,
             [],
             Enum.random([:pub, :sub]),
             @most
           ) do
        {:ok, events, parts, rest} ->
          assert is_list(events) and is_list(parts) and is_binary(rest)

        {:error, why} ->
          assert is_binary(why)
      end
    end
  end
end
