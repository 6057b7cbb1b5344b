defmodule Situ.Assistant.PlayerTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.Assistant.Player
  alias Situ.{AudioBuffer, AudioFormat}

  @ms 1_000_000
  # A frame lasts one millisecond.
  @format AudioFormat.pcm(1_000, 1, :s16)

  defp sound(from, to), do: AudioBuffer.from_samples(Enum.to_list(from..(to - 1)), @format)
  defp message(time, from, to), do: {time * @ms, sound(from, to)}

  defp start do
    Situ.Test.start([:in, :stop], fn streams ->
      out = Situ.via(Map.to_list(streams), Player, chunk: 40 * @ms, ahead: 80 * @ms)
      [out.out, out.speaking]
    end)
  end

  defp outputs(test) do
    [sounds, speaking] = Situ.Test.outputs(test)

    {for({t, buffer} <- sounds, do: {div(t, @ms), AudioBuffer.to_samples(buffer)}),
     for({t, s} <- speaking, do: {div(t, @ms), s})}
  end

  defp samples(played), do: Enum.flat_map(played, &elem(&1, 1))

  test "plays a small part immediately and the rest by the clock, in order" do
    test = start()
    Situ.Test.advance(test, 1_000 * @ms)
    Situ.Test.feed(test, :in, [message(1_000, 0, 200)])
    {played, speaking} = outputs(test)
    assert [{960, first}, {1_000, _}] = played
    assert first == Enum.to_list(0..39) and speaking == [{1_000, true}]
    Situ.Test.advance(test, 41 * @ms)
    assert {[{1_040, _}], []} = outputs(test)
    Situ.Test.feed(test, :in, [message(1_020, 200, 230)])
    for _ <- 1..20, do: Situ.Test.advance(test, 20 * @ms)
    {rest, speaking} = outputs(test)
    assert samples(rest) == Enum.to_list(120..229)
    assert speaking == [{1_241, false}]
    Situ.Test.stop(test)
  end

  test "falls silent when stopped, and plays the reply to the interruption" do
    test = start()
    Situ.Test.advance(test, 2_000 * @ms)
    Situ.Test.feed(test, :in, [message(2_000, 0, 500)])
    assert {[_, _], [{2_000, true}]} = outputs(test)
    Situ.Test.advance(test, 100 * @ms)
    _ = outputs(test)
    Situ.Test.feed(test, :stop, [{2_050 * @ms, "computer"}])
    for _ <- 1..10, do: Situ.Test.advance(test, 20 * @ms)
    assert {[], [{_, false}]} = outputs(test)
    # This audio was decided after the interruption, so a late stop does not affect it.
    Situ.Test.advance(test, 1_000 * @ms)
    Situ.Test.feed(test, :in, [message(2_060, 700, 800)])
    Situ.Test.feed(test, :stop, [{2_055 * @ms, "computer"}])
    for _ <- 1..10, do: Situ.Test.advance(test, 20 * @ms)
    {played, _} = outputs(test)

    assert inspect(samples(played), limit: :infinity) ==
             inspect(Enum.to_list(700..799), limit: :infinity)

    Situ.Test.stop(test)
  end

  property "plays all of the audio, without a gap while more is available" do
    forall lengths <- list(integer(1, 300)) do
      {sounds, total} =
        Enum.map_reduce(lengths, 0, fn n, at -> {message(at, at, at + n), at + n} end)

      {:ok, [played, _]} =
        Situ.Test.run([in: sounds], fn %{in: sounds} ->
          out = Situ.via([in: sounds], Player, [])
          [out.out, out.speaking]
        end)

      times = Enum.map(played, &elem(&1, 0))

      Enum.flat_map(played, fn {_, b} -> AudioBuffer.to_samples(b) end) ==
        Enum.to_list(0..(total - 1)//1) and times == Enum.sort(times)
    end
  end
end
