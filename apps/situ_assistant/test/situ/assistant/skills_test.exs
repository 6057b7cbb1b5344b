defmodule Situ.Assistant.SkillsTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  doctest Situ.Assistant.Skills
  doctest Situ.Assistant.EchoDetector
  doctest Situ.Assistant.Dialogue

  alias Situ.Assistant.Skills
  alias Situ.Infer.Speech.Number
  alias Situ.Intent.Grammar

  @now {{2026, 11, 22}, {14, 35, 0}}

  defp answer(text) do
    {:ok, grammar} = Grammar.load(grammar: Skills.grammar())
    {:ok, intent} = Grammar.detect(grammar, text)
    Skills.answer_intent(intent, @now)
  end

  test "understands spoken requests and responds to them" do
    assert answer("What time is it?") == {:say, "It is fourteen thirty five."}

    assert answer("Could you tell me the time now, please") ==
             {:say, "It is fourteen thirty five."}

    assert answer("What's the date today?") == {:say, "It is Sunday, November the twenty second."}
    assert {:timer, 90_000_000_000, "ninety seconds", _} = answer("Set a timer for 90 seconds.")
    assert {:timer, 3_600_000_000_000, "one hour", _} = answer("Wake me in one hour")
    assert {:timer, 120_000_000_000, "two minutes", _} = answer("start a two minute timer")
    assert answer("set a timer") == :unknown
    assert answer("cancel the timer") == :cancel
    assert answer("Stop!") == :quiet
    assert answer("the cat sat on the mat") == :unknown
  end

  property "every time and date is spoken in words" do
    forall {h, m, d} <- {integer(0, 23), integer(0, 59), integer(1, 31)} do
      time = Skills.time_in_words({{2026, 12, d}, {h, m, 0}})
      date = Skills.date_in_words({{2026, 12, d}, {h, m, 0}})

      time =~ ~r/\AIt is [a-z' ]+\.\z/ and
        date =~ ~r/\AIt is [A-Z][a-z]+, December the [a-z ]+\.\z/
    end
  end

  property "a timer has exactly the requested length" do
    forall n <- integer(1, 999) do
      for spoken <- ["#{n}", Number.to_words(n)] do
        {:timer, ns, _, _} = answer("set a timer for #{spoken} minutes")
        true = ns == n * 60_000_000_000
      end
    end
  end
end
