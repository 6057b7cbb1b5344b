defmodule Situ.Python.ProtocolTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Python.Protocol
  doctest Protocol

  defp encode_emissions(emissions) do
    for {output, time, place} <- emissions, into: <<>> do
      place = place |> Protocol.encode_place() |> IO.iodata_to_binary()
      <<output, time::little-signed-64, place::binary>>
    end
  end

  defp place do
    slot =
      map({integer(0, 99), integer(0, 1_000_000), integer(1, 1_000)}, fn {number, offset, length} ->
        %{number: number, offset: offset, capacity: length + 10, length: length}
      end)

    one_of([{:bytes, binary()}, {:slot, slot}])
  end

  property "decodes results" do
    forall results <-
             list(one_of([list({integer(0, 255), integer(), place()}), {binary(), binary()}])) do
      frame =
        for result <- results, into: <<"T", 7::little-64>> do
          case result do
            {text, fix} ->
              <<1, byte_size(text)::little-32, text::binary, byte_size(fix)::little-32,
                fix::binary>>

            emissions ->
              <<0, length(emissions)::little-16, encode_emissions(emissions)::binary>>
          end
        end

      expected =
        for result <- results do
          case result do
            {text, fix} -> {:raised, text, fix}
            emissions -> {:ok, emissions}
          end
        end

      assert Protocol.decode_frame(frame) == {:ok, {:results, expected, 7}}
    end
  end

  property "rejects or decodes any bytes, and never raises" do
    forall {letter, bytes} <- {one_of(~c"TLODEX"), binary()} do
      case Protocol.decode_frame(<<letter, bytes::binary>>) do
        :error -> true
        {:ok, frame} -> is_tuple(frame)
      end
    end
  end

  property "rejects results that were cut" do
    forall {place, cut} <- {place(), integer(1, 20)} do
      frame = <<"T", 0::64, 0, 1::little-16, encode_emissions([{0, 1, place}])::binary>>
      shorter = binary_part(frame, 0, max(byte_size(frame) - cut, 12))
      assert Protocol.decode_frame(shorter) == :error
    end
  end

  property "encodes plain numbers as all other values" do
    forall number <- one_of([integer(), float(), integer(-1_000_000_000_000, 1_000_000_000_000)]) do
      {:ok, bytes} = Protocol.encode_value(number)
      assert Protocol.decode_value(IO.iodata_to_binary(bytes)) == {:ok, number}

      {:ok, plain} = Situ.Store.ValueCodec.encode(number)
      assert IO.iodata_to_binary(bytes) == IO.iodata_to_binary(plain)
    end
  end
end
