defmodule Situ.Link.Wire.FrameTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Link.Wire.Frame
  doctest Frame

  defp u32, do: integer(0, 0xFFFFFFFF)
  defp time, do: integer(-0x8000000000000000, 0x7FFFFFFFFFFFFFFF)

  defp json do
    value = one_of([integer(), ascii_text(), boolean(), list(ascii_text())])
    map(list({ascii_text(), value}), &Map.new/1)
  end

  defp frame do
    one_of([
      {:hello, integer(0, 0xFFFF), integer(0, 0xFFFF), binary(16)},
      {:login, binary(32), json()},
      {:welcome, binary(32), json()},
      {:refused, json()},
      {:streams, json()},
      {:subscribe, u32(), json()},
      {:subscribed, u32(), json()},
      {:unsubscribe, u32()},
      {:credit, u32(), u32()},
      {:batch, u32(), time(), time(), u32(), binary()},
      {:part, u32(), boolean(), binary()},
      {:closed, u32(), time()},
      {:lost, u32(), integer(0, 0xFFFFFFFFFFFFFFFF)},
      {:ping, time()},
      {:pong, time(), time(), time()},
      {:request, u32(), json()},
      {:reply, u32(), binary()}
    ])
  end

  defp bytes(frame), do: frame |> Frame.encode() |> IO.iodata_to_binary()

  property "a frame survives a round trip", numtests: 500 do
    forall frame <- frame() do
      assert Frame.decode(bytes(frame)) == {:ok, frame}
    end
  end

  property "any bytes are a frame or a readable error", numtests: 500 do
    forall {kind, rest} <- {integer(0, 20), binary()} do
      case Frame.decode(<<kind, rest::binary>>) do
        {:ok, frame} -> assert bytes(frame) != ""
        {:error, why} -> assert is_binary(why)
      end
    end
  end

  property "a truncated frame is an error or has a shorter payload", numtests: 300 do
    forall {frame, keep} <- {frame(), integer(0, 60)} do
      whole = bytes(frame)
      assert {kind, _} = Frame.decode(binary_part(whole, 0, min(keep, byte_size(whole))))
      assert kind in [:ok, :error]
    end
  end

  test "the greeting of a later version is still a greeting" do
    nonce = :binary.copy(<<5>>, 16)
    later = IO.iodata_to_binary([Frame.encode({:hello, 9, 4, nonce}), "and more"])
    assert Frame.decode(later) == {:ok, {:hello, 9, 4, nonce}}
    assert {:error, _} = Frame.decode(<<1, "HTTP">>)
  end
end
