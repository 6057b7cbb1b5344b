defmodule Situ.Infer.SpeechRecognizerTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.{AudioBuffer, AudioFormat}
  alias Situ.Infer.SpeechRecognizer

  # "Recognizes" which frames it receives: sample i has the value i.
  defmodule Counting do
    @behaviour Situ.Infer.Speech.Recognizer

    @impl true
    def load(opts), do: if(opts[:broken], do: {:error, opts[:broken]}, else: {:ok, :counting})

    @impl true
    def transcribe(:counting, buffer) do
      samples = AudioBuffer.to_samples(buffer)
      {:ok, %{text: "#{hd(samples)}-#{List.last(samples)}", confidence: 1.0}}
    end
  end

  # 1000 frames a second, so a frame lasts one millisecond.
  @format AudioFormat.pcm(1000, 1, :s32)
  @ms 1_000_000

  defp sound(ms, step) do
    for from <- 0..(ms - 1)//step do
      samples = Enum.to_list(from..(min(from + step, ms) - 1))
      {(from + length(samples)) * @ms, AudioBuffer.from_samples(samples, @format)}
    end
  end

  defp speaking(ms, spoken) do
    for t <- 32..ms//32, do: {t * @ms, Enum.any?(spoken, fn {a, b} -> t > a and t <= b end)}
  end

  defp run(sound, speaking, opts) do
    opts = Keyword.merge([recognizer: Counting, partial: nil, margin: 0, shortest: 0], opts)

    Situ.to_list(
      fn p ->
        inputs = [
          sound: Situ.from_enumerable(p, sound),
          speaking: Situ.from_enumerable(p, speaking)
        ]

        heard = Situ.via(inputs, SpeechRecognizer, Keyword.delete(opts, :output))
        Map.fetch!(heard, Keyword.get(opts, :output, :out))
      end,
      times: true
    )
  end

  test "recognizes the speech between pauses as one utterance, at its end" do
    out = run(sound(2_000, 20), speaking(2_000, [{96, 320}, {640, 960}]), [])
    assert [{320_000_000, first}, {960_000_000, second}] = out

    assert {first.from, first.to, first.text, first.final?} ==
             {96 * @ms, 320 * @ms, "96-319", true}

    assert {second.from, second.to, second.text} == {640 * @ms, 960 * @ms, "640-959"}
  end

  test "includes a margin around speech, and speech up to the end of the audio" do
    out = run(sound(1_000, 20), speaking(992, [{96, 320}, {640, 992}]), margin: 50 * @ms)
    assert Enum.map(out, fn {_, u} -> u.text end) == ["46-369", "590-999"]
  end

  test "margins end where other speech begins, so no audio is in two utterances" do
    spoken = speaking(1_984, [{96, 640}, {672, 960}])
    out = run(sound(2_000, 20), spoken, margin: 150 * @ms, turns: true)
    assert Enum.map(out, fn {_, u} -> u.text end) == ["0-671", "640-1109"]

    out =
      run(sound(2_000, 20), speaking(1_984, [{96, 1_600}]), margin: 100 * @ms, longest: 640 * @ms)

    assert Enum.map(out, fn {_, u} -> u.text end) == ["0-735", "736-1375", "1376-1699"]
  end

  test "ignores sounds that are shorter than speech" do
    spoken = [{96, 320}, {640, 736}, {960, 1_248}]
    out = run(sound(2_000, 20), speaking(2_000, spoken), shortest: 200 * @ms)
    assert Enum.map(out, fn {_, u} -> u.text end) == ["96-319", "960-1247"]
  end

  test "emits partial results while someone is speaking" do
    out =
      run(sound(2_000, 20), speaking(2_000, [{96, 1_600}]), partial: 320 * @ms, output: :partial)

    assert [{416_000_000, %{final?: false, text: "96-415"}}, {736_000_000, %{text: "96-735"}} | _] =
             out
  end

  test "cuts speech without pauses" do
    out = run(sound(2_000, 20), speaking(2_000, [{0, 2_000}]), longest: 640 * @ms)
    assert [%{text: "0-639"} | _] = utterances = Enum.map(out, &elem(&1, 1))
    assert List.last(utterances).to == 1_984 * @ms

    assert utterances
           |> Enum.chunk_every(2, 1, :discard)
           |> Enum.all?(fn [a, b] -> b.from >= a.to end)
  end

  property "the result does not depend on buffer sizes and the order of arrival" do
    forall {step, cuts} <- {integer(5, 300), list(integer(1, 40))} do
      {_, spoken} =
        Enum.reduce(cuts, {0, []}, fn n, {at, spoken} ->
          {at + 64 * n, [{at + 32 * n, at + 64 * n} | spoken]}
        end)

      ms = 32 * (2 * Enum.sum(cuts) + 4)
      asked = speaking(ms, spoken)
      plain = run(sound(ms, 32), asked, [])
      other = run(sound(ms, step), asked, [])
      length(plain) == length(cuts) and plain == other
    end
  end

  property "early recognition in a pause gives the same result" do
    forall cuts <- list(integer(1, 40)) do
      {_, spoken} =
        Enum.reduce(cuts, {0, []}, fn n, {at, spoken} ->
          {at + 64 * n, [{at + 32 * n, at + 64 * n} | spoken]}
        end)

      ms = 32 * (2 * Enum.sum(cuts) + 4)
      asked = speaking(ms, spoken)
      run(sound(ms, 32), asked, []) == run(sound(ms, 32), asked, early: 64 * @ms)
    end
  end

  test "when late, drops partial results but none of the speech" do
    partial = fn behind ->
      test =
        Situ.Test.start([:sound, :speaking], fn s ->
          opts = [recognizer: Counting, partial: 320 * @ms, margin: 0, late: 500 * @ms]
          heard = Situ.via(Map.to_list(s), SpeechRecognizer, opts)
          [heard.partial, heard.out]
        end)

      # The clock is already past all of the audio when it arrives.
      Situ.Test.advance(test, (2_000 + behind) * @ms)
      Situ.Test.feed(test, :sound, sound(2_000, 20))
      Situ.Test.feed(test, :speaking, speaking(2_000, [{96, 1_800}]))
      [partial, out] = Situ.Test.outputs(test)
      Situ.Test.stop(test)
      {Enum.map(partial, &elem(&1, 0)), length(out)}
    end

    assert {[_ | _] = late, 1} = partial.(0)
    assert Enum.all?(late, &(&1 >= 1_500 * @ms))
    assert {[], 1} = partial.(1_000)
  end

  # Notifies the test of every call.
  defmodule Telling do
    @behaviour Situ.Infer.Speech.Recognizer

    @impl true
    def load(opts), do: {:ok, opts[:test]}

    @impl true
    def transcribe(test, buffer) do
      samples = AudioBuffer.to_samples(buffer)
      send(test, {:asked, hd(samples), List.last(samples)})
      {:ok, %{text: "#{hd(samples)}-#{List.last(samples)}", confidence: 1.0}}
    end
  end

  test "recognizes during the pause, and only once" do
    me = self()

    test =
      Situ.Test.start([:sound, :speaking], fn s ->
        opts = [
          recognizer: Telling,
          recognizer_options: [test: me],
          partial: nil,
          margin: 50 * @ms
        ]

        Situ.via(Map.to_list(s), SpeechRecognizer, opts ++ [early: 100 * @ms]).out
      end)

    Situ.Test.advance(test, 2_000 * @ms)
    all = sound(2_000, 20)
    {before, later} = Enum.split_while(all, fn {time, _} -> time <= 440 * @ms end)
    Situ.Test.feed(test, :speaking, for(t <- 32..320//32, do: {t * @ms, t > 96}))
    Situ.Test.feed(test, :sound, before)
    assert_receive {:asked, 46, 369}
    assert Situ.Test.outputs(test) == []
    # It was the end of the utterance.
    Situ.Test.feed(test, :speaking, for(t <- 352..640//32, do: {t * @ms, false}))
    Situ.Test.feed(test, :sound, later)
    Situ.Test.close(test, :speaking)
    Situ.Test.close(test, :sound)
    assert [{_, %{text: "46-369"}}] = Situ.Test.outputs(test)
    refute_received {:asked, _, _}
    Situ.Test.stop(test)
  end

  test "a recognizer that cannot be loaded stops the pipeline with its error" do
    error = Situ.Error.new(:no_model_file, "the model is not there")

    assert_raise Situ.Error, ~r/not there/, fn ->
      run(sound(100, 20), [], recognizer_options: [broken: error])
    end
  end
end
