defmodule Situ.Infer.VoiceTest do
  use ExUnit.Case, async: true

  alias Situ.{AudioBuffer, AudioFormat, Message}
  alias Situ.Infer.{SimpleVad, VoiceActivity, VoiceGate}

  @fixtures Path.expand("../../fixtures", __DIR__)
  @step 32_000_000

  # Calls the component's callbacks directly, without processes.
  defp listen(pcm, opts \\ []) do
    {:ok, state} = VoiceActivity.init(Situ.Options.validate!(opts, VoiceActivity.options()))
    {[], state} = VoiceActivity.handle_start(nil, state)

    # Buffers have an odd length, because chunks must not depend on them.
    {actions, {state, time}} =
      pcm
      |> chunks(2 * 333)
      |> Enum.flat_map_reduce({state, 0}, fn data, {state, time} ->
        time = time + div(byte_size(data), 2) * 62_500
        message = %Message{originating_time: time, data: AudioBuffer.new!(data: data)}
        {actions, state} = VoiceActivity.handle_message(:in, message, nil, state)
        {actions, {state, time}}
      end)

    {last, _} = VoiceActivity.handle_closed(:in, time, nil, state)
    actions ++ last
  end

  defp chunks(<<>>, _), do: []
  defp chunks(data, n) when byte_size(data) <= n, do: [data]

  defp chunks(data, n),
    do: [binary_part(data, 0, n) | chunks(binary_part(data, n, byte_size(data) - n), n)]

  defp wav(name) do
    <<_::binary-44, pcm::binary>> = File.read!(Path.join(@fixtures, name))
    binary_part(pcm, 0, byte_size(pcm) - rem(byte_size(pcm), 2))
  end

  defp speaking(actions), do: for({:speaking, time, yes?} <- actions, do: {time, yes?})

  test "Silero gives the reference's probabilities" do
    expected =
      for <<p::float-little-32 <- File.read!(Path.join(@fixtures, "golden/silero.f32"))>>, do: p

    found = for {:voice, _, voice} <- listen(wav("cards_002.wav")), do: voice.probability
    assert length(found) == length(expected)
    assert Enum.zip_with(found, expected, &abs(&1 - &2)) |> Enum.max() < 1.0e-4
  end

  test "at least 97 % of the frames of the speech files and all segments are correct" do
    files =
      @fixtures |> Path.join("transcripts.json") |> File.read!() |> Situ.JSON.decode() |> elem(1)

    {right, all} =
      for(
        {file, %{"silero_segments" => segments}} <- files,
        file != "two_cities.wav",
        do: {file, segments}
      )
      |> Enum.reduce({0, 0}, fn {file, segments}, {right, all} ->
        actions = listen(wav(file))
        decisions = speaking(actions)
        # Every chunk is decided once, in order.
        assert Enum.map(decisions, &elem(&1, 0)) ==
                 for({:voice, t, _} <- actions, do: t) |> Enum.sort()

        ok =
          Enum.count(decisions, fn {time, yes?} ->
            middle = (time - @step / 2) / 1.0e9
            yes? == Enum.any?(segments, fn [from, to] -> middle >= from and middle < to end)
          end)

        found = for {:segments, _, s} <- actions, do: {s.start / 1.0e9, s.stop / 1.0e9}
        assert length(found) == length(segments), "#{file}: #{inspect(found)}"

        for {{a, b}, [c, d]} <- Enum.zip(found, segments),
            do: assert(abs(a - c) < 0.11 and abs(b - d) < 0.11)

        {right + ok, all + length(decisions)}
      end)

    assert right / all >= 0.97
  end

  test "finds no speech in silence, white noise and a tone" do
    :rand.seed(:exsss, {1, 2, 3})
    silence = :binary.copy(<<0, 0>>, 32_000)
    noise = for _ <- 1..32_000, into: <<>>, do: <<round(:rand.normal() * 2000)::little-signed-16>>

    tone =
      for i <- 1..32_000,
          into: <<>>,
          do: <<round(:math.sin(i * 0.1728) * 9000)::little-signed-16>>

    for sound <- [silence, noise, tone], detector <- [:silero, :energy] do
      refute Enum.any?(speaking(listen(sound, detector: detector)), &elem(&1, 1))
    end
  end

  test "the energy detector finds the same words without a model" do
    actions = listen(wav("goforward.wav"), detector: :energy)
    assert [_ | _] = segments = for({:segments, _, s} <- actions, do: s)
    assert_in_delta hd(segments).start / 1.0e9, 0.51, 0.2
    # The recording's breath after the last word also has energy.
    assert_in_delta List.last(segments).stop / 1.0e9, 2.24, 0.5
  end

  test "audio of another rate is rejected with a fix" do
    {:ok, state} =
      VoiceActivity.init(Situ.Options.validate!([detector: :energy], VoiceActivity.options()))

    {[], state} = VoiceActivity.handle_start(nil, state)
    data = AudioBuffer.build_silence(AudioFormat.pcm(48_000, 2), 480)
    message = %Message{originating_time: 0, data: data}

    error =
      assert_raise Situ.Error, fn -> VoiceActivity.handle_message(:in, message, nil, state) end

    assert error.code == :bad_audio_format and error.fix =~ "resample"
  end

  test "incomplete and non-numeric samples are rejected by name, also by recognizers" do
    float = AudioFormat.pcm(16_000, 1, :f32)
    whole = for _ <- 1..16_000, into: "", do: <<0.1::float-little-32>>

    none =
      binary_part(whole, 0, 400) <> <<0x7FC00000::little-32>> <> binary_part(whole, 0, 60_000)

    for {buffer, told} <- [
          {%AudioBuffer{format: float, data: none}, "sample 100 is not a number"},
          {%AudioBuffer{format: float, data: <<0x7F800000::little-32>>}, "sample 0 is not"},
          {%AudioBuffer{format: AudioFormat.pcm(16_000), data: <<1, 2, 3>>}, "3 bytes"}
        ] do
      {:ok, state} =
        VoiceActivity.init(Situ.Options.validate!([detector: :energy], VoiceActivity.options()))

      {[], state} = VoiceActivity.handle_start(nil, state)
      message = %Message{originating_time: 0, data: buffer}

      error =
        assert_raise Situ.Error, fn -> VoiceActivity.handle_message(:in, message, nil, state) end

      assert error.code == :bad_audio and error.what =~ told and error.fix != nil

      assert {:error, ^error} =
               Situ.Infer.Speech.PocketSphinx.transcribe(
                 struct(Situ.Infer.Speech.PocketSphinx),
                 buffer
               )
    end
  end

  describe "VoiceGate" do
    test "bridges a short pause and cuts a long pause where the speech ended" do
      gate = VoiceGate.new(min_speech: 20, min_silence: 30)
      ps = [0.9, 0.9, 0.1, 0.9, 0.1, 0.1, 0.1, 0.1]

      {events, gate} =
        ps
        |> Enum.with_index(1)
        |> Enum.flat_map_reduce(gate, fn {p, i}, g -> VoiceGate.push(g, i * 10, 10, p) end)

      {last, _} = VoiceGate.close(gate)
      values = for {t, v} <- events ++ last, do: {t, v}

      assert values == [
               {10, true},
               {20, true},
               {30, true},
               {40, true},
               {50, false},
               {60, false},
               {70, false},
               {80, false}
             ]

      assert {:segment, 0, 40} in events
    end

    test "a short burst is not speech" do
      gate = VoiceGate.new(min_speech: 30, min_silence: 20)
      {a, gate} = VoiceGate.push(gate, 10, 10, 0.9)
      {b, gate} = VoiceGate.push(gate, 20, 10, 0.1)
      {c, gate} = VoiceGate.push(gate, 30, 10, 0.1)
      {d, _} = VoiceGate.close(gate)
      assert a ++ b ++ c ++ d == [{10, false}, {20, false}, {30, false}]
    end
  end

  test "the simple detector keeps its state until all values agree" do
    vad = SimpleVad.new(window: 20)
    values = [1, 1, 9, 9, 9, 9, 1, 9, 1, 1, 1, 1]

    {out, vad} =
      values
      |> Enum.with_index()
      |> Enum.flat_map_reduce(vad, fn {v, i}, vad -> SimpleVad.push(vad, i * 10, v) end)

    {last, _} = SimpleVad.close(vad)
    # It switches on after three consecutive values above the threshold and off after three below.
    assert Enum.map(out ++ last, &elem(&1, 1)) ==
             [false, false, true, true, true, true, true, true, false, false, false, false]
  end

  test "the simple detector decides with the value that ends the window, not by one at the threshold" do
    vad = SimpleVad.new(window: 20, threshold: 5)
    {[], vad} = SimpleVad.push(vad, 0, 9)
    {[], vad} = SimpleVad.push(vad, 10, 9)
    {[{0, true}], vad} = SimpleVad.push(vad, 20, 9)
    {[{10, true}], vad} = SimpleVad.push(vad, 30, 1)
    {[{20, true}], vad} = SimpleVad.push(vad, 40, 5)
    {[{30, true}], vad} = SimpleVad.push(vad, 50, 1)
    assert {[{40, true}, {50, false}], _vad} = SimpleVad.close(vad)
  end

  # Audio louder than a tenth of full scale is speech. Counts the chunks it receives.
  defmodule Loud do
    @behaviour Situ.Infer.Voice.Detector

    @impl true
    def load(opts), do: {:ok, {opts[:on], 0}}

    @impl true
    def reset({on, _}), do: {on, 0}

    @impl true
    def step({on, n}, chunk, level) do
      2_048 = byte_size(chunk)
      {:ok, if(level > 0.1, do: on, else: 0.0), {on, n + 1}}
    end
  end

  test "a custom detector is a module, and an invalid one is an error immediately" do
    quiet = :binary.copy(<<100::little-16>>, 16_000)
    loud = :binary.copy(<<9_000::little-16>>, 16_000)
    actions = listen(quiet <> loud <> quiet, detector: Loud)
    assert [%{start: start, stop: stop}] = for({:segments, _, segment} <- actions, do: segment)
    assert_in_delta start, 1_000_000_000, @step
    assert_in_delta stop, 2_000_000_000, @step

    assert {:error, %{code: :bad_option}} =
             Situ.Options.validate([detector: "loud"], VoiceActivity.options())
  end
end
