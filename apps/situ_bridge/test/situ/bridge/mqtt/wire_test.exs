defmodule Situ.Bridge.Mqtt.WireTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Bridge.Mqtt.{Properties, Subscription, Wire}

  defp bytes(iodata), do: IO.iodata_to_binary(iodata)

  test "encodes the bytes of the standard" do
    assert bytes(Wire.encode_connect(id: "a")) ==
             <<0x10, 13, 4::16, "MQTT", 4, 2, 0::16, 1::16, "a">>

    assert bytes(Wire.encode_connect(id: "a", clean: false, username: "u", password: "p")) ==
             <<0x10, 19, 4::16, "MQTT", 4, 0xC0, 0::16, 1::16, "a", 1::16, "u", 1::16, "p">>

    assert bytes(Wire.encode_subscribe(1, "a/#", qos: 1)) == <<0x82, 8, 1::16, 3::16, "a/#", 1>>

    assert bytes(Wire.encode_publish("t", "x", qos: 1, id: 7, retain: true)) ==
             <<0x33, 6, 1::16, "t", 7::16, "x">>

    assert <<0x30, 0xCB, 0x01, _::binary>> =
             bytes(Wire.encode_publish("t", :binary.copy("x", 200), []))
  end

  test "encodes the properties of MQTT 5" do
    assert bytes(Wire.encode_connect(id: "a", version: 5, properties: [session_expiry: 60])) ==
             <<0x10, 19, 4::16, "MQTT", 5, 2, 0::16, 5, 0x11, 60::32, 1::16, "a">>

    will = [topic: "w", payload: "x", qos: 2, retain: true, delay: 3]

    assert bytes(Wire.encode_connect(id: "a", version: 5, clean: false, will: will)) ==
             <<0x10, 26, 4::16, "MQTT", 5, 0x34, 0::16, 0, 1::16, "a", 5, 0x18, 3::32, 1::16, "w",
               1::16, "x">>

    assert bytes(
             Wire.encode_subscribe(1, "a", version: 5, qos: 2, no_local: true, retain_handling: 2)
           ) ==
             <<0x82, 7, 1::16, 0, 1::16, "a", 0x26>>

    assert bytes(
             Wire.encode_publish("t", "x",
               version: 5,
               qos: 2,
               id: 7,
               properties: [user_properties: [{"a", "b"}]]
             )
           ) ==
             <<0x34, 14, 1::16, "t", 7::16, 7, 0x26, 1::16, "a", 1::16, "b", "x">>

    assert bytes(Wire.encode_acknowledgement(:pubrel, 7)) == <<0x62, 2, 7::16>>
  end

  property "reads published messages wherever the bytes are split" do
    forall {payloads, at, version} <- {list(binary()), non_neg_integer(), one_of([4, 5])} do
      sent =
        for {p, i} <- Enum.with_index(payloads, 1),
            do: Wire.encode_publish("a/b", p, version: version, qos: rem(i, 3), id: i)

      all = bytes(sent)
      {first, second} = cut(all, rem(at, byte_size(all) + 1))
      {:ok, early, answer, state} = Subscription.read(first, subscription(version), 10_000)
      {:ok, late, more, %{buffer: ""}} = Subscription.read(second, state, 10_000)

      acknowledged =
        for {_, i} <- Enum.with_index(payloads, 1),
            rem(i, 3) > 0,
            do: Wire.encode_acknowledgement(Enum.at([:puback, :pubrec], rem(i, 3) - 1), i)

      early ++ late == payloads and answer <> more == bytes(acknowledged)
    end
  end

  defp subscription(version \\ 4, arg \\ []) do
    {_hello, state} =
      Subscription.hello("h", 1, [id: "a", topic: "t", qos: 2, version: version] ++ arg)

    state
  end

  defp cut(bytes, at),
    do: {binary_part(bytes, 0, at), binary_part(bytes, at, byte_size(bytes) - at)}

  property "reads any bytes as a packet, as incomplete, or as an error" do
    forall {bytes, kind, version} <- {binary(), integer(0, 15), one_of([4, 5])} do
      packet = bytes([kind * 16, Properties.encode_variable(byte_size(bytes)), bytes])

      for bytes <- [bytes, packet] do
        case Wire.parse_packet(bytes, 1_000, version) do
          {:ok, _packet, rest} -> byte_size(rest) < byte_size(bytes)
          :more -> true
          {:error, why} -> is_binary(why)
        end
      end
      |> Enum.all?()
    end
  end

  property "reads the properties that it wrote" do
    texts = {ascii_text(), ascii_text()}

    forall {pairs, content_type, expiry, data} <-
             {list(texts), ascii_text(), integer(0, 4_294_967_295), binary()} do
      written = %{
        content_type: content_type,
        correlation_data: data,
        message_expiry: expiry,
        receive_maximum: rem(expiry, 65_536),
        payload_format: rem(expiry, 256)
      }

      written = if pairs == [], do: written, else: Map.put(written, :user_properties, pairs)
      Properties.parse(bytes([Properties.encode(written), "rest"])) == {:ok, written, "rest"}
    end
  end

  test "rejects unknown, repeated and incomplete properties, and texts that are not UTF-8" do
    for body <- [<<0x7F>>, <<1, 0, 1, 0>>, <<2, 0>>, <<3, 9::16, "a">>, <<3, 1::16, 0xFF>>],
        do: assert(Properties.parse(<<byte_size(body), body::binary>>) == :error)

    assert Properties.parse(<<9, 1>>) == :error
    assert Properties.parse(<<0xFF, 0xFF, 0xFF, 0xFF, 1>>) == :error
  end

  test "reports why a broker refused" do
    assert {:reconnect, "the broker: the user name or the password is wrong", _} =
             Subscription.read(<<0x20, 2, 0, 4>>, subscription(), 1_000)

    assert {:error, "the broker refuses the subscription"} =
             Subscription.read(<<0x20, 2, 0, 0, 0x90, 3, 0, 1, 0x80>>, subscription(), 1_000)

    assert {:error, "a packet of 2000000 bytes exceeds the limit"} =
             Subscription.read(<<0x30, 0x80, 0x89, 0x7A>>, subscription(), 1_000)

    refused = <<0x20, 12, 0, 0x87, 9, 0x1F, 6::16, "no acl">>

    assert {:reconnect, "the broker: this user is not authorized: no acl (code 0x87)", _} =
             Subscription.read(refused, subscription(5), 1_000)

    assert {:error, "the broker: it is shutting down (code 0x8B)"} =
             Subscription.read(<<0xE0, 1, 0x8B>>, subscription(5), 1_000)
  end
end
