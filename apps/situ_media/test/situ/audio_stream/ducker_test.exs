defmodule Situ.AudioStream.DuckerTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.{AudioStream, AudioBuffer, AudioFormat}

  @format AudioFormat.pcm(1000)
  @ms 1_000_000

  # Both inputs arrive in time order, as in a live pipeline.
  defp duck(n, while, opts \\ []) do
    test = Situ.Test.start([:sound, :while], fn s -> AudioStream.duck(s.sound, s.while, opts) end)
    Situ.Test.advance(test, (n + 1) * 10 * @ms)
    buffer = AudioBuffer.from_samples(List.duplicate(10_000, 10), @format)
    sound = for i <- 1..n, do: {i * 10 * @ms, :sound, buffer}

    for {at, input, value} <-
          Enum.sort(sound ++ for({at, value} <- while, do: {at * @ms, :while, value})),
        do: Situ.Test.feed(test, input, [{at, value}])

    Situ.Test.close(test, :while)
    out = Situ.Test.outputs(test)
    Situ.Test.stop(test)
    Map.new(out, fn {time, buffer} -> {div(time, @ms), AudioBuffer.to_samples(buffer)} end)
  end

  test "lowers the volume while the signal holds and a little longer, without steps" do
    out = duck(100, [{1, false}, {201, true}, {401, false}, {990, false}], by: 20)
    assert Enum.all?(out[200], &(&1 == 10_000))
    assert Enum.all?(out[300] ++ out[400] ++ out[500], &(&1 == 1_000))
    assert Enum.all?(out[900], &(&1 == 10_000))
    all = Enum.flat_map(1..100, &out[&1 * 10])
    steps = all |> Enum.chunk_every(2, 1, :discard) |> Enum.map(fn [a, b] -> abs(a - b) end)
    assert Enum.max(steps) <= 501
  end

  property "never makes audio louder or changes its length, for any input" do
    forall changes <- list({integer(1, 200), integer(0, 1)}) do
      while =
        changes
        |> Enum.uniq_by(&elem(&1, 0))
        |> Enum.sort()
        |> Enum.map(fn {at, v} -> {at, v == 1} end)

      out = duck(20, while)

      map_size(out) == 20 and
        Enum.all?(out, fn {_, s} -> length(s) == 10 and Enum.all?(s, &(&1 in 0..10_000)) end)
    end
  end
end
