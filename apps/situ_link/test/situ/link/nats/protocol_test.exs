defmodule Situ.Link.Nats.ProtocolTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.Link.Nats.Protocol

  doctest Situ.Link.Nats.Protocol

  property "the parser handles any bytes" do
    forall bytes <- binary() do
      case Protocol.parse_frame("MSG a 1 " <> bytes, 1_000) do
        :more -> true
        {:ok, _, rest} -> is_binary(rest)
        {:error, text} -> is_binary(text)
      end
    end
  end

  property "a message equals the published one, however the bytes are cut" do
    forall {data, at} <- {binary(), non_neg_integer()} do
      "HPUB a.b _R " <> rest =
        IO.iodata_to_binary(Protocol.encode_publish("a.b", "_R", [{"K", "v w"}], data))

      bytes = "HMSG a.b 1 _R " <> rest
      at = rem(at, byte_size(bytes))

      Protocol.parse_frame(binary_part(bytes, 0, at), 100_000) == :more and
        match?(
          {:ok, {:message, %{data: ^data, headers: %{"K" => "v w"}, reply: "_R"}}, "next"},
          Protocol.parse_frame(bytes <> "next", 100_000)
        )
    end
  end
end
