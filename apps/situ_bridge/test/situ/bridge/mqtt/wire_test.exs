defmodule Situ.Bridge.Mqtt.WireTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Bridge.Mqtt.{Subscription, Wire}

  defp bytes(iodata), do: IO.iodata_to_binary(iodata)

  test "encodes the bytes of the standard" do
    assert bytes(Wire.encode_connect(id: "a")) ==
             <<0x10, 13, 4::16, "MQTT", 4, 2, 0::16, 1::16, "a">>

    assert bytes(Wire.encode_connect(id: "a", session: "a", username: "u", password: "p")) ==
             <<0x10, 19, 4::16, "MQTT", 4, 0xC0, 0::16, 1::16, "a", 1::16, "u", 1::16, "p">>

    assert bytes(Wire.encode_subscribe(1, "a/#", 1)) == <<0x82, 8, 1::16, 3::16, "a/#", 1>>

    assert bytes(Wire.encode_publish("t", "x", qos: 1, id: 7, retain: true)) ==
             <<0x33, 6, 1::16, "t", 7::16, "x">>

    assert <<0x30, 0xCB, 0x01, _::binary>> =
             bytes(Wire.encode_publish("t", :binary.copy("x", 200), []))
  end

  property "reads published messages wherever the bytes are split" do
    forall {payloads, at} <- {list(binary()), non_neg_integer()} do
      sent =
        for {p, i} <- Enum.with_index(payloads, 1),
            do: Wire.encode_publish("a/b", p, qos: rem(i, 2), id: i)

      all = bytes(sent)
      {first, second} = cut(all, rem(at, byte_size(all) + 1))
      {:ok, early, answer, rest} = Subscription.read(first, "", 10_000)
      {:ok, late, more, ""} = Subscription.read(second, rest, 10_000)

      acknowledged =
        for {_, i} <- Enum.with_index(payloads, 1), rem(i, 2) == 1, do: Wire.encode_puback(i)

      early ++ late == payloads and answer <> more == bytes(acknowledged)
    end
  end

  defp cut(bytes, at),
    do: {binary_part(bytes, 0, at), binary_part(bytes, at, byte_size(bytes) - at)}

  property "reads any bytes as a packet, as incomplete, or as an error" do
    forall bytes <- binary() do
      case Wire.parse_packet(bytes, 1_000) do
        {:ok, _packet, rest} -> byte_size(rest) < byte_size(bytes)
        :more -> true
        {:error, why} -> is_binary(why)
      end
    end
  end

  test "reports why a broker refused" do
    assert {:error, "the broker: the user name or the password is wrong"} =
             Subscription.read(<<0x20, 2, 0, 4>>, "", 1_000)

    assert {:error, "the broker refuses the subscription"} =
             Subscription.read(<<0x20, 2, 0, 0, 0x90, 3, 0, 1, 0x80>>, "", 1_000)

    assert {:error, "a packet of 2000000 bytes exceeds the limit"} =
             Subscription.read(<<0x30, 0x80, 0x89, 0x7A>>, "", 1_000)
  end
end
