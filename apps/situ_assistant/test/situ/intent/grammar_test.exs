defmodule Situ.Intent.GrammarTest do
  use ExUnit.Case, async: true

  alias Situ.Intent.Grammar

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

  test "a grammar's file that cannot be read is an error" do
    assert {:error, %{code: :no_grammar}} = Grammar.load(grammar: "/nowhere.gram")
  end
end
