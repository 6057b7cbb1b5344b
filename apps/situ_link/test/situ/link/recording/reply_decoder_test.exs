defmodule Situ.Link.Recording.ReplyDecoderTest do
  # A malformed response from a server must never raise and never be accepted.
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Link.Recording.ReplyDecoder

  @readers ~w(decode_info decode_number decode_summary decode_tracks decode_spans decode_strings decode_notice)a

  defp all(body) do
    for(name <- @readers, do: apply(ReplyDecoder, name, [body])) ++
      [ReplyDecoder.decode_streams(body, "here"), ReplyDecoder.decode_messages(body, 1)]
  end

  defp one_of_two?(answers), do: Enum.all?(answers, &(&1 == :error or match?({:ok, _}, &1)))

  property "any bytes are a response or rejected", numtests: 500 do
    forall body <- binary() do
      one_of_two?(all(body))
    end
  end

  property "any term is a response or rejected", numtests: 500 do
    forall term <- term() do
      one_of_two?(all(:erlang.term_to_binary(term)))
    end
  end

  test "a stream's entry is accepted completely or not at all" do
    good = %{Map.from_struct(%Situ.Store.StreamInfo{id: 1, name: "n"}) | type_name: ":float"}
    body = &:erlang.term_to_binary/1

    assert {:ok, [%{name: "n", type: :float, store_path: "there"}]} =
             ReplyDecoder.decode_streams(body.([good]), "there")

    for {key, bad} <- [name: 1, id: nil, first: "x", codecs: [], supplemental: 3, type_name: nil],
        do:
          assert(ReplyDecoder.decode_streams(body.([Map.put(good, key, bad)]), "there") == :error)
  end
end
