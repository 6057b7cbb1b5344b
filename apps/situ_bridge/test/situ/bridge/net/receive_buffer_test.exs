defmodule Situ.Bridge.Net.ReceiveBufferTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Bridge.Mqtt.Subscription
  alias Situ.Bridge.Net.ReceiveBuffer
  alias Situ.Bridge.Tcp.Frames
  doctest ReceiveBuffer

  property "returns frames unchanged from chunks of any size" do
    forall {payloads, size, sizes} <- {list(binary()), integer(1, 40), list(integer(1, 40))} do
      bytes = payloads |> Enum.map(&Frames.frame/1) |> IO.iodata_to_binary()
      {got, _reads} = through(Frames, cut(bytes, [size | sizes]), "")
      assert got == payloads
    end
  end

  test "parses a large frame once, when it is complete" do
    payload = :crypto.strong_rand_bytes(3_000_000)
    bytes = payload |> Frames.frame() |> IO.iodata_to_binary()
    {got, reads} = through(Frames, cut(bytes, [1_460]), "")
    assert got == [payload]
    assert reads == 2

    published = IO.iodata_to_binary(Situ.Bridge.Mqtt.Wire.encode_publish("t", payload, qos: 0))
    {_hello, state} = Subscription.hello("h", 1, id: "a", topic: "t", qos: 0, version: 4)
    {got, reads} = through(Subscription, cut(published, [1_460]), state)
    assert got == [payload]
    assert reads == 2
  end

  defp cut("", _sizes), do: []

  defp cut(bytes, [size | sizes]) do
    size = min(size, byte_size(bytes))
    <<piece::binary-size(size), rest::binary>> = bytes
    [piece | cut(rest, sizes ++ [size])]
  end

  # Reads like a source: returns the payloads, and how often the protocol was called.
  defp through(module, cut, state) do
    {_pieces, _state, got, reads} =
      Enum.reduce(cut, {%ReceiveBuffer{}, state, [], 0}, fn bytes, {pieces, state, got, reads} ->
        case ReceiveBuffer.add_bytes(pieces, bytes, module.missing_bytes(state)) do
          {:more, pieces} ->
            {pieces, state, got, reads}

          {:ok, bytes, pieces} ->
            {:ok, payloads, _answer, state} = module.read(bytes, state, 10_000_000)
            {pieces, state, got ++ payloads, reads + 1}
        end
      end)

    {got, reads}
  end
end
