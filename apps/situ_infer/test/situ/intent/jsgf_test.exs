defmodule Situ.Intent.JsgfTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  doctest Situ.Intent.Jsgf
  doctest Situ.Intent.Number

  alias Situ.Intent.{Grammar, Jsgf, Number}

  @cards """
  #JSGF V1.0 UTF-8 en; // a header with encoding and language
  /* cards,
     as PocketSphinx has them */
  grammar cards;
  public <card> = <rank> {rank} of <suit> {suit} | [the] "joker";
  <rank> = /0.5/ ace | two | /2/ king | (ten);
  <suit> = clubs | hearts;
  public <hand> = (<card> [and])+ please * {polite};
  """

  defp detect(grammar, text, opts \\ []) do
    {:ok, grammar} = Grammar.load([grammar: grammar] ++ opts)
    {:ok, intent} = Grammar.detect(grammar, text)
    {Situ.Intent.name(intent), for(e <- intent.entities, do: {e.type, e.value})}
  end

  test "supports all of JSGF" do
    assert detect(@cards, "Ten of hearts", where: :whole) ==
             {"card", [{"rank", "ten"}, {"suit", "hearts"}]}

    assert detect(@cards, "the joker", where: :whole) == {"card", []}

    assert {"hand",
            [
              {"rank", "ace"},
              {"suit", "clubs"},
              {"rank", "king"},
              {"suit", "hearts"},
              {"polite", "please please"}
            ]} = detect(@cards, "ace of clubs and king of hearts please please", where: :whole)

    assert detect(@cards, "ten of hearts now", where: :whole) == {nil, []}
    assert {"card", _} = detect(@cards, "give me ten of hearts now")
  end

  test "tags name intents and entities, with numbers as numbers and words as words" do
    grammar =
      "#JSGF V1.0; grammar g; public <a> = call {intent=dial} <WORDS> {who} at <NUMBER> {at} | <VOID> x | <NULL> hm;"

    assert detect(grammar, "call my old friend at twenty one") ==
             {"dial", [{"who", "my old friend"}, {"at", "21"}]}

    assert detect(grammar, "hm") == {"a", []}
    assert detect(grammar, "x") == {nil, []}
  end

  test "rules may recurse on either side, and many words take little time" do
    right = "#JSGF V1.0; grammar g; public <l> = a [<l>];"
    left = "#JSGF V1.0; grammar g; public <l> = <l> a | a;"
    assert detect(right, "a a a a", where: :whole) == {"l", []}
    assert {"l", []} = detect(left, "a a")
    # Each level doubles the number of parses, so the matcher must track positions only.
    levels = for i <- 1..30, into: "", do: "<r#{i}> = <r#{i - 1}> <r#{i - 1}> | <r#{i - 1}> ;"
    deep = "#JSGF V1.0; grammar g; public <top> = <r30>; <r0> = a | a | [a] a;" <> levels
    assert {"top", []} = detect(deep, String.duplicate("a ", 100), where: :whole)
  end

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

    assert {:error, %{code: :no_grammar}} = Grammar.load(grammar: "/nowhere.gram")
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
