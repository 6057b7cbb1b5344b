defmodule Situ.Infer.Speech.TokenizerTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Infer.Speech.Tokenizer
  doctest Situ.Infer.Speech.Tokenizer

  test "long entries have two-byte lengths, and letters may be split across tokens" do
    long = String.duplicate("x", 300)
    file = <<rem(300, 128) + 128, div(300, 128)>> <> long <> <<1, 0xC3, 1, 0xA4>>
    assert {:ok, tokenizer} = Tokenizer.parse(file)
    assert Tokenizer.decode_tokens(tokenizer, [0]) == long
    assert Tokenizer.decode_tokens(tokenizer, [1, 2]) == "ä"
    assert Tokenizer.decode_tokens(tokenizer, [1, 99]) == ""
  end

  property "any bytes are a vocabulary or an error, and any tokens are text" do
    forall {bytes, tokens} <- {binary(), list(non_neg_integer())} do
      case Tokenizer.parse(bytes) do
        {:ok, tokenizer} -> String.valid?(Tokenizer.decode_tokens(tokenizer, tokens))
        :error -> true
      end
    end
  end
end
