defmodule Situ.Link.Rendezvous.ProtocolTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Link.Rendezvous.Protocol
  doctest Protocol

  defp streams, do: list({ascii_text(), ascii_text()})
  defp port, do: integer(0, 65_535)

  defp endpoint do
    one_of([
      {:tcp, ascii_text(), port(), streams()},
      {:address, ascii_text(), streams()},
      {:exporter, ascii_text(), port(), integer(0, 2), streams()},
      {:clock, ascii_text(), port(), []}
    ])
  end

  defp update do
    process =
      map({ascii_text(), ascii_text(), list(endpoint())}, fn {name, version, endpoints} ->
        %{name: name, version: version, endpoints: endpoints}
      end)

    one_of([:disconnect, {:remove, ascii_text()}, {:add, process}])
  end

  property "updates survive a round trip, however the bytes are cut", numtests: 25 do
    forall {updates, cut} <- {list(update()), integer(0, 1_000)} do
      bytes = updates |> Enum.map(&Protocol.encode/1) |> IO.iodata_to_binary()
      assert read(bytes, []) == {updates, ""}
      before = binary_part(bytes, 0, min(cut, byte_size(bytes)))
      {first, _rest} = read(before, [])
      assert first == Enum.take(updates, length(first))
    end
  end

  defp read(bytes, done) do
    case Protocol.decode(bytes) do
      {:ok, update, rest} -> read(rest, [update | done])
      :more -> {Enum.reverse(done), bytes}
    end
  end

  property "parses the same updates byte by byte", numtests: 50 do
    forall update <- update() do
      bytes = IO.iodata_to_binary(Protocol.encode(update))

      {last, continue} =
        for <<byte <- bytes>>, reduce: {nil, &Protocol.feed/1} do
          {nil, continue} -> step(continue.(<<byte>>))
          other -> {{:late, other}, nil}
        end

      {last, continue} == {{:ok, update, ""}, nil}
    end
  end

  defp step({:more, continue}), do: {nil, continue}
  defp step(done), do: {done, nil}

  property "noise is an update, incomplete or a readable error", numtests: 500 do
    forall {kind, noise} <- {integer(0, 5), binary()} do
      case Protocol.decode(<<kind, noise::binary>>) do
        {:ok, _update, rest} -> assert is_binary(rest)
        :more -> :ok
        {:error, why} -> assert is_binary(why)
      end
    end
  end

  test "encodes like the reference" do
    process = %{name: "p", version: "v", endpoints: [{:exporter, "h", 11_411, 1, [{"s", "t"}]}]}

    expected =
      <<1, 1, "p", 1, "v", 1::little-32, 2, 1, "h", 11_411::little-32, 1::little-32, 1::little-32,
        1, "s", 1, "t">>

    assert IO.iodata_to_binary(Protocol.encode({:add, process})) == expected
    long = String.duplicate("x", 300)
    assert IO.iodata_to_binary(Protocol.encode_text(long)) == <<0xAC, 0x02, long::binary>>
  end
end
