defmodule Situ.Studio.Alerts.RuleTest do
  use ExUnit.Case, async: true
  alias Situ.Studio.Alerts.Rule
  doctest Rule

  test "a line that is no rule is named, with what is wrong with it" do
    for {text, why} <- [
          {"a: x > 1\n\nno rule", "a name, a colon and an expression"},
          {"a: 1 > 2", "names no stream"},
          {": x > 1", "a name, a colon"},
          {"a: x >", "at character"}
        ] do
      assert {:error, %{code: :bad_rule, what: what, why: told}} = Rule.read(text)
      assert told =~ why
      assert what =~ ~r/line \d/
    end

    assert {:ok, []} = Rule.read(" \n\n")
    assert {:error, %{code: :too_many}} = Rule.read(String.duplicate("a: x > 1\n", 51))
  end

  test "what looks like a statistic and is none is a stream" do
    {:ok, [rule]} = Rule.read("a: `queue(Slow)` > 1 or `mood(Slow)` > 1")
    assert Rule.statistics(rule) == [{"queue(Slow)", "queue", "Slow"}]
    assert Rule.streams(rule) == ["mood(Slow)"]
    refute Rule.true?(rule, %{})
  end
end
