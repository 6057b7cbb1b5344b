defmodule Situ.Infer.SpeakerTurnsTest do
  use ExUnit.Case, async: true
  alias Situ.Infer.{SpeakerTurns, Voice}

  # Voice values every 32 ms and images every 40 ms; the function `deal` merges both lists into one order.
  defp run(seconds, voice, who, deal \\ &by_time/2) do
    heard = for t <- 32..round(seconds * 1000)//32, do: {:heard, t, voice.(t)}

    seen =
      for t <- 0..round(seconds * 1000)//40, do: {:who, t, Map.new([0, 1], &{&1, &1 == who.(t)})}

    {out, turns} =
      Enum.flat_map_reduce(deal.(heard, seen), SpeakerTurns.new(), fn
        {:heard, t, {speaking?, p}}, turns ->
          SpeakerTurns.push_speech(turns, t * 1_000_000, speaking?, %Voice{
            probability: p,
            level: 0.1 * p
          })

        {:who, t, who}, turns ->
          SpeakerTurns.push_speakers(turns, t * 1_000_000, who)
      end)

    {last, _} = SpeakerTurns.push_speakers(turns, :infinity, %{})

    {rest, _} =
      SpeakerTurns.handle_closed(
        :heard,
        0,
        nil,
        elem(SpeakerTurns.push_speakers(turns, :infinity, %{}), 1)
      )

    for {:out, time, value} <- out ++ last ++ rest, do: {div(time, 1_000_000), value}
  end

  defp by_time(heard, seen), do: Enum.sort_by(heard ++ seen, &elem(&1, 1))

  defp cuts(out), do: for({time, false} <- out, do: time)

  # Continuous speech from 0 to 6 s with a short dip at 3 s; the lips show the change of speaker 0.4 s later.
  defp dip(t) when t in 2_980..3_080, do: {true, 0.1}
  defp dip(_), do: {true, 1.0}

  test "cuts speech where the voice dips, near the change of speaker" do
    out = run(6, &dip/1, &if(&1 < 3_400, do: 0, else: 1))
    assert [cut] = cuts(out)
    assert cut in 2_980..3_100
    assert length(out) == div(6_000, 32)
  end

  test "the result does not depend on the order of arrival" do
    who = &if(&1 < 3_400, do: 0, else: 1)
    expected = run(6, &dip/1, who)
    assert run(6, &dip/1, who, &(&1 ++ &2)) == expected
    assert run(6, &dip/1, who, &(&2 ++ &1)) == expected
  end

  test "one speaker, a pause or a glance at another face adds no cut" do
    assert cuts(run(6, &dip/1, fn _ -> 0 end)) == []
    assert cuts(run(6, &dip/1, fn t -> if t in 3_000..3_200, do: 1, else: 0 end)) == []
    assert cuts(run(6, &dip/1, fn t -> if t in 2_000..2_600, do: nil, else: 0 end)) == []

    pause = fn t -> if t in 2_700..3_100, do: {false, 0.0}, else: {true, 1.0} end
    assert Enum.all?(cuts(run(6, pause, &if(&1 < 3_400, do: 0, else: 1))), &(&1 in 2_700..3_100))

    assert Enum.all?(
             cuts(run(6, pause, &if(&1 < 2_700, do: 0, else: if(&1 > 3_800, do: 1)))),
             &(&1 in 2_700..3_100)
           )
  end

  test "an off-screen voice that continues where a face stops is another speaker" do
    assert [cut] = cuts(run(6, &dip/1, &if(&1 < 3_600, do: 0)))
    assert cut in 2_980..3_100
  end

  test "without images, all messages pass unchanged" do
    turns = SpeakerTurns.new()
    {[], turns} = SpeakerTurns.push_speech(turns, 32, true, %Voice{probability: 1.0, level: 0.1})
    {out, turns} = SpeakerTurns.push_speakers(turns, :infinity, %{})
    assert out == [{:out, 32, true}]

    assert {[{:out, 64, false}], _} =
             SpeakerTurns.push_speech(turns, 64, false, %Voice{probability: 0.0, level: 0.0})
  end
end
