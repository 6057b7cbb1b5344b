defmodule Situ.Studio.Alerts.RuleTest do
  use ExUnit.Case, async: true
  alias Situ.Studio.Alerts.Rule
  doctest Rule

  test "reports an invalid line, with its number and the reason" do
    for {text, why} <- [
          {"a: x > 1\n\nno rule", "a name, a colon and an expression"},
          {"a: 1 > 2", "does not name a stream"},
          {": x > 1", "a name, a colon"},
          {"a: x >", "at character"}
        ] do
      assert {:error, %{code: :bad_rule, what: what, why: told}} = Rule.parse_rules(text)
      assert told =~ why
      assert what =~ ~r/line \d/
    end

    assert {:ok, []} = Rule.parse_rules(" \n\n")
    assert {:error, %{code: :too_many}} = Rule.parse_rules(String.duplicate("a: x > 1\n", 51))
  end

  test "treats an unknown statistic as a stream" do
    {:ok, [rule]} = Rule.parse_rules("a: `queue(Slow)` > 1 or `mood(Slow)` > 1")
    assert Rule.referenced_statistics(rule) == [{"queue(Slow)", "queue", "Slow"}]
    assert Rule.referenced_streams(rule) == ["mood(Slow)"]
    refute Rule.true?(rule, %{})
  end
end
