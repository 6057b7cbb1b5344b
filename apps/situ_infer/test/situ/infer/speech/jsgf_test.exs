defmodule Situ.Infer.Speech.JsgfTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  doctest Situ.Infer.Speech.Jsgf
  doctest Situ.Infer.Speech.Number

  alias Situ.Infer.Speech.{Jsgf, Number}

  test "errors contain the line number" do
    wrong = [
      {"grammar g;", "line 1: the text does not begin"},
      {"#JSGF V1.0;\npublic <a> = b;", "`grammar NAME;`"},
      {"#JSGF V1.0; grammar g;\n\npublic <a> = (b;", "line 3: a group"},
      {"#JSGF V1.0; grammar g;\n<a> = b | ;", "line 2: an alternative"},
      {"#JSGF V1.0; grammar g;\npublic <a> = {x} b;", "line 2: {x} has no preceding item"},
      {"#JSGF V1.0; grammar g;\npublic <a> = b {x;", "line 2: a tag"},
      {"#JSGF V1.0; grammar g; public <a> = b; <a> = c;", "<a> is defined twice"},
      {"#JSGF V1.0; grammar g; public <a> = <kichen>; <kitchen> = b;", "did you mean <kitchen>?"},
      {"#JSGF V1.0; grammar g; <a> = b;", "no rule is public"},
      {"#JSGF V1.0; grammar g; import <other.*>;", "import"},
      {"#JSGF V1.0; grammar g; public <a> = " <> String.duplicate("(", 300), "deep"},
      {<<"#JSGF", 255>>, "UTF-8"}
    ]

    for {text, part} <- wrong do
      assert {:error, %{code: :bad_grammar, why: why}} = Jsgf.parse(text)
      assert why =~ part
    end
  end

  property "any text is a grammar or an error and creates no atoms" do
    piece =
      one_of(
        Enum.map(
          ~w(<a> = ; | [ ] \( \) * + {t} "q" word public /1/ // /*) ++ [" ", "\n"],
          &constant/1
        )
      )

    forall pieces <- list(piece) do
      result = Jsgf.parse("#JSGF V1.0; grammar g; public <a> = " <> Enum.join(pieces, " "))
      match?({:ok, %Jsgf{}}, result) or match?({:error, %Situ.Error{}}, result)
    end
  end

  property "understands every number as it is spoken" do
    forall n <- integer(0, 999) do
      words = n |> Number.to_words() |> String.split()

      hd(Number.parse_prefixes(words)) == {length(words), n} and
        hd(Number.parse_prefixes(["#{n}"])) == {1, n}
    end
  end
end
