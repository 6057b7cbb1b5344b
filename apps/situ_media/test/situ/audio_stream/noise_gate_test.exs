defmodule Situ.AudioStream.NoiseGateTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.{AudioStream, AudioBuffer, AudioFormat}
  alias Situ.AudioStream.Ramp
  doctest Situ.AudioStream.Ramp

  @format AudioFormat.pcm(1000)
  @ms 1_000_000

  # One sample per millisecond, cut into buffers of the given lengths.
  defp gate(samples, lengths, opts) do
    {feed, _, _} =
      Enum.reduce(lengths, {[], samples, 0}, fn n, {feed, left, at} ->
        {now, left} = Enum.split(left, n)
        at = at + length(now)

        if now == [],
          do: {feed, left, at},
          else: {[{at * @ms, AudioBuffer.from_samples(now, @format)} | feed], left, at}
      end)

    Situ.to_list(
      fn p -> p |> Situ.from_enumerable(Enum.reverse(feed)) |> AudioStream.noise_gate(opts) end,
      times: true
    )
  end

  defp samples(out), do: Enum.flat_map(out, fn {_, buffer} -> AudioBuffer.to_samples(buffer) end)

  test "cuts noise and passes speech, including a short pause in it" do
    noise = List.duplicate(40, 100)
    speech = List.duplicate(8_000, 100)

    out =
      gate(
        noise ++ speech ++ List.duplicate(40, 50) ++ speech ++ List.duplicate(40, 400),
        [1_000],
        []
      )

    [quiet, first, pause, second, _, tail, end_] =
      [0..99, 110..199, 200..249, 250..349, 350..499, 500..599, 640..749]
      |> Enum.map(&Enum.slice(samples(out), &1))

    assert Enum.all?(quiet, &(&1 == 0))
    assert Enum.all?(first ++ second, &(&1 == 8_000))
    assert Enum.all?(pause, &(&1 == 40))
    # Held for 150 ms, then closed slowly.
    assert Enum.all?(tail, &(&1 <= 40)) and List.last(tail) < 5
    assert Enum.all?(end_, &(&1 == 0))
  end

  test "a floor lets some noise through, and contradictory levels are an error" do
    assert [20 | _] =
             gate(List.duplicate(40, 20), [20], floor: 20 * :math.log10(0.5)) |> samples()

    assert_raise Situ.Error, ~r/must not be above/, fn ->
      gate([1], [1], open: -50, close: -40)
    end
  end

  property "output is never louder, keeps its length and does not depend on buffer sizes" do
    forall {values, lengths} <- {list(integer(-20_000, 20_000)), list(integer(1, 60))} do
      samples = Enum.flat_map(values, &List.duplicate(&1, 7))
      whole = gate(samples, [length(samples)], [])
      cut = gate(samples, lengths ++ [length(samples)], [])
      out = samples(cut)

      whole == cut and length(out) == length(samples) and
        Enum.zip(samples, out) |> Enum.all?(fn {x, y} -> abs(y) <= abs(x) and x * y >= 0 end)
    end
  end

  property "a ramp stays between its ends" do
    forall {sample, from, to, n} <-
             {integer(0, 32_000), integer(0, 100), integer(0, 100), integer(1, 50)} do
      {from, to} = {from / 100, to / 100}

      out =
        Ramp.scale_buffer(AudioBuffer.from_samples(List.duplicate(sample, n), @format), from, to)
        |> AudioBuffer.to_samples()

      {low, high} = {min(from, to) * sample - 1, max(from, to) * sample + 1}
      Enum.all?(out, &(&1 >= low and &1 <= high)) and abs(List.last(out) - to * sample) <= 1
    end
  end
end
