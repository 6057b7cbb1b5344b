defmodule Situ.AudioStream.AnalyzerTest do
  use ExUnit.Case, async: true
  doctest Situ.AudioStream.Analyzer
  import Bitwise

  alias Situ.{AudioBuffer, AudioFormat}
  alias Situ.AudioStream.Analyzer

  @format AudioFormat.pcm(16_000)

  # Reference values computed with \psi's own source on one frame of 400 samples, with dither off and in float32:
  # {log energy, zero crossings, energy, low, high, entropy (nil where \psi returns NaN), peak bin}
  @golden %{
    tone: {12.14154, 0.05, 1.920002e10, 1.920002e10, 1.450995e3, 0.2533658, 14},
    two_tones: {16.78592, 0.0, 1.996790e12, 1.919974e12, 7.681675e10, nil, 32},
    noise: {18.63918, 0.5425, 1.000943e13, 3.023347e12, 7.638281e12, 0.9099362, 217},
    silence: {-92.1, 0.0, 0.0, 0.0, 0.0, nil, 0},
    click: {13.81551, 0.0, 8.679988e10, 3.560002e10, 5.799994e10, 0.9999989, nil}
  }

  defp signal(:tone),
    do: for(n <- 0..399, do: round(1000 * :math.sin(2 * :math.pi() * 440 * n / 16_000)))

  defp signal(:two_tones) do
    for n <- 0..399 do
      t = 2 * :math.pi() * n / 16_000
      round(10_000 * :math.sin(1000 * t) + 2000 * :math.sin(5000 * t))
    end
  end

  defp signal(:noise) do
    {samples, _} =
      Enum.map_reduce(0..399, 12_345, fn _, s ->
        s = band(s * 1_664_525 + 1_013_904_223, 0xFFFFFFFF)
        {bsr(s, 16) - 32_768, s}
      end)

    samples
  end

  defp signal(:silence), do: List.duplicate(0, 400)
  defp signal(:click), do: for(n <- 0..399, do: if(n == 200, do: 20_000, else: 0))

  defp analyze(samples, opts \\ []) do
    {:ok, analyzer} = Analyzer.new(@format, [dither: 0, power: true, spectrum: true] ++ opts)

    {:ok, frames} =
      Analyzer.extract_features(analyzer, AudioBuffer.from_samples(samples, @format))

    frames
  end

  for name <- Map.keys(@golden) do
    test "the features of #{name} match \\psi's" do
      {log_energy, zcr, energy, low, high, entropy, peak} = Map.fetch!(@golden, unquote(name))
      assert [frame] = analyze(signal(unquote(name)))
      assert_in_delta frame.log_energy, log_energy, 1.0e-4
      assert_in_delta frame.zero_crossing_rate, zcr, 1.0e-9
      assert close?(frame.energy, energy)
      assert close?(frame.low_energy, low)
      assert close?(frame.high_energy, high)
      if entropy, do: assert_in_delta(frame.entropy, entropy, 1.0e-5)
      assert frame.entropy >= 0 and frame.entropy <= 1

      if peak,
        do: assert(peak == Enum.find_index(frame.power, &(&1 == Enum.max(frame.power))))
    end
  end

  test "silence has entropy 0, not NaN" do
    assert [%{entropy: 0.0}] = analyze(signal(:silence))
  end

  test "the spectrum is the textbook transform of the windowed frame" do
    samples = signal(:noise)
    [frame] = analyze(samples)
    assert length(frame.spectrum) == 256

    for k <- [0, 1, 7, 100, 255] do
      {re, im} = dft(samples, k)
      {got_re, got_im} = Enum.at(frame.spectrum, k)
      assert_in_delta got_re, re, 1.0e-3
      assert_in_delta got_im, im, 1.0e-3
    end
  end

  defp dft(samples, k) do
    samples
    |> Enum.with_index()
    |> Enum.reduce({0.0, 0.0}, fn {v, n}, {re, im} ->
      v = v * 0.5 * (1 - :math.cos(2 * :math.pi() * n / 400))
      angle = -2 * :math.pi() * k * n / 512
      {re + v * :math.cos(angle), im + v * :math.sin(angle)}
    end)
  end

  defp close?(a, b), do: abs(a - b) <= 2.0e-4 * max(abs(b), 1.0)

  describe "as a component" do
    test "frames end where their samples end, for any buffer sizes" do
      samples = Enum.flat_map(1..4, fn _ -> signal(:noise) end)
      expected = for k <- 0..7, do: AudioFormat.frames_to_ns(16_000, 400 + 160 * k)

      for sizes <- [[1600], [100, 700, 800], [399, 1, 161, 1039]] do
        out = run(cut(samples, sizes), power: true)
        assert Enum.map(out.log_energy, &elem(&1, 0)) == expected

        assert out.power |> Enum.map(&elem(&1, 1)) |> Enum.map(&length/1) ==
                 List.duplicate(256, 8)

        assert out == run(cut(samples, [1600]), power: true)
      end
    end

    test "dither lifts silence off the floor and is deterministic" do
      out = run(cut(signal(:silence), [400]), dither: 1.0)
      assert [{_, energy}] = out.log_energy
      # The mean square of uniform noise in -1..1 is 1/3, and the periodic Hann window's is 3/8.
      assert_in_delta energy, :math.log(1 / 8), 0.5
      assert out == run(cut(signal(:silence), [400]), dither: 1.0)
    end

    defp run(feed, opts) do
      build = fn p ->
        p
        |> Situ.from_enumerable(feed)
        |> Situ.AudioStream.features(Keyword.merge([dither: 0], opts))
        |> Map.take([:log_energy, :power, :entropy])
      end

      Situ.to_list(build, times: true)
    end

    defp cut(samples, sizes) do
      {feed, _} =
        Enum.map_reduce(sizes, {samples, 0}, fn size, {rest, done} ->
          {piece, rest} = Enum.split(rest, size)
          time = AudioFormat.frames_to_ns(16_000, done + size)
          {{time, AudioBuffer.from_samples(piece, @format)}, {rest, done + size}}
        end)

      feed
    end
  end

  test "float samples give the same results as 16-bit samples" do
    format = AudioFormat.pcm(16_000, 1, :f32)
    floats = AudioBuffer.from_samples(Enum.map(signal(:noise), &(&1 / 32_768)), format)
    {:ok, analyzer} = Analyzer.new(format, dither: 0, mel_bands: 8)
    {:ok, [frame]} = Analyzer.extract_features(analyzer, floats)
    [reference] = analyze(signal(:noise), mel_bands: 8)
    assert_in_delta frame.log_energy, reference.log_energy, 1.0e-6
    for {a, b} <- Enum.zip(frame.log_mel, reference.log_mel), do: assert_in_delta(a, b, 1.0e-6)
  end

  test "rejects impossible frame options" do
    assert {:error, %{code: :bad_option}} = Analyzer.new(@format, frame: 0.001, frame_rate: 1)
    assert {:error, %{code: :bad_option}} = Analyzer.new(@format, mel_bands: 4, mfcc: 5)
  end
end
