defmodule Situ.Infer.Speech.UtteranceTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Infer.Speech.Utterance
  doctest Situ.Infer.Speech.Utterance

  property "the error rate counts inserted, deleted and replaced words" do
    forall {truth, extra, at} <-
             {list(one_of(["a", "b", "c"])), list(integer(0, 9)), integer(0, 20)} do
      text = Enum.join(truth, " ")
      {before, behind} = Enum.split(truth, at)
      longer = Enum.join(before ++ Enum.map(extra, &to_string/1) ++ behind, ", ")
      n = max(length(truth), 1)

      Utterance.error_rate(text, String.upcase(text) <> "!") == 0.0 and
        Utterance.error_rate(text, longer) == length(extra) / n and
        Utterance.error_rate(text, "") == length(truth) / n
    end
  end
end
