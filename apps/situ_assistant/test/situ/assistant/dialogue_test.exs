defmodule Situ.Assistant.DialogueTest do
  use ExUnit.Case, async: true

  alias Situ.Assistant.{Dialogue, Interruption}
  alias Situ.Infer.Speech.Utterance

  @s 1_000_000_000
  @clock [local_time: &__MODULE__.noon/1]

  def noon(ns), do: {{2026, 11, 22}, {12, div(ns, 60 * @s), 0}}

  defp start(opts \\ []) do
    Situ.Test.start([:heard], fn %{heard: heard} ->
      out = Situ.via([heard: heard], Dialogue, opts ++ @clock)
      [out.said, out.ask, out.intent]
    end)
  end

  # Speech of one second that ends at `to`; the clock has also reached `to`.
  defp hear(test, to, text) do
    Situ.Test.advance(test, to * @s - Situ.Clock.now(test.clock))

    Situ.Test.feed(test, :heard, [
      {to * @s, %Utterance{text: text, from: (to - 1) * @s, to: to * @s, confidence: 1.0}}
    ])

    texts(test)
  end

  defp texts(test) do
    [said, ask, _intents] = Situ.Test.outputs(test)
    Enum.map(said, &elem(&1, 1)) ++ Enum.map(ask, &{:ask, elem(&1, 1)})
  end

  test "responds to its name, in one or two utterances, and without it only while listening" do
    test = start()
    assert hear(test, 2, "What time is it?") == []
    assert hear(test, 4, "Computer, what time is it?") == ["It is noon."]

    assert hear(test, 8, "And what day is it today?") == [
             "It is Sunday, November the twenty second."
           ]

    assert hear(test, 30, "What time is it?") == []
    assert hear(test, 40, "Hey, Compute!") == ["Yes?"]
    assert hear(test, 62, "What time is it?") == []
    assert hear(test, 64, "computer") == ["Yes?"]
    assert hear(test, 66, "What time is it?") == ["It is twelve oh one."]
    Situ.Test.stop(test)
  end

  test "timers ring on time unless they were cancelled" do
    test = start(wake: nil)
    assert hear(test, 2, "Set a timer for ten seconds") == ["I set a timer for ten seconds."]
    Situ.Test.advance(test, 9 * @s)
    assert texts(test) == []
    Situ.Test.advance(test, 1 * @s)
    assert texts(test) == ["Your timer of ten seconds is over."]
    assert hear(test, 20, "set a timer for five seconds") == ["I set a timer for five seconds."]
    assert hear(test, 22, "cancel my timer please") == ["I canceled the timer."]
    Situ.Test.advance(test, 60 * @s)
    assert texts(test) == []
    assert hear(test, 90, "cancel the timer") == ["No timer is set."]
    Situ.Test.stop(test)
  end

  test "ignores its own words coming back from the speaker" do
    test = start(wake: nil)
    assert ["I set a timer" <> _] = hear(test, 2, "Set a timer for ten seconds")
    assert hear(test, 4, "I set a timer for ten second") == []
    assert ["I did not" <> _] = hear(test, 6, "Good morning")
    Situ.Test.stop(test)
  end

  test "asks about unknown requests, says so, or leaves them to the program" do
    test = start(ask: true)
    assert hear(test, 2, "Computer, who was Ada Lovelace?") == [{:ask, "who was ada lovelace"}]
    # Without its name nothing happens, because the reply may still be playing.
    assert hear(test, 4, "She was a mathematician.") == []
    Situ.Test.stop(test)
    assert ["I did not understand that."] = hear(start(wake: nil), 2, "Who was Ada Lovelace?")
    light = "#JSGF V1.0; grammar g; public <light> = [turn] light on {intent=light};"
    test = start(wake: nil, grammar: light)
    assert hear(test, 2, "Turn light on") == []
    Situ.Test.stop(test)
  end

  test "is interrupted once, by the first words that are not its own" do
    ms = 1_000_000

    heard = fn from, to, text ->
      said = %Utterance{text: text, from: from * ms, to: to * ms, confidence: 1.0, final?: false}
      {to * ms, said}
    end

    test =
      Situ.Test.start([:partial, :heard, :said], fn streams ->
        Situ.via(Map.to_list(streams), Interruption)
      end)

    Situ.Test.advance(test, 9_000 * ms)
    Situ.Test.feed(test, :said, [{0, "It is fourteen thirty five."}])
    Situ.Test.feed(test, :partial, [heard.(500, 1_100, "it is fourteen")])

    Situ.Test.feed(test, :partial, [
      heard.(2_000, 2_300, "Come"),
      heard.(2_000, 2_600, "Computer")
    ])

    Situ.Test.feed(test, :partial, [heard.(2_000, 2_900, "Computer stop")])
    Situ.Test.feed(test, :heard, [heard.(2_000, 3_100, "Computer, stop.")])
    assert Situ.Test.outputs(test) == [{2_600 * ms, "Computer"}]
    Situ.Test.stop(test)
  end
end
