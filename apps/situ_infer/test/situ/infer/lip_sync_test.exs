defmodule Situ.Infer.LipSyncTest do
  use ExUnit.Case, async: true

  alias Situ.Infer.{LipSync, Mouth, Voice}

  doctest LipSync

  @ms 1_000_000

  # Syllables of 150 ms, all different: how open the mouth is, and so how loud the voice is, at a time in ms.
  defp openness(t, seed) do
    {syllable, part} = {Integer.floor_div(t, 150), Integer.mod(t, 150) / 150}
    size = &(:erlang.phash2({seed, &1}, 1_000) / 1_000)
    0.15 * (size.(syllable) * (1 - part) + size.(syllable + 1) * part)
  end

  defp mouth(opening, t),
    do: %Mouth{opening: opening, baseline: 0.0, open?: opening > 0.03, time: t * @ms}

  # Two faces: `speaker` talks, and the other one chews.
  defp clip(shift_ms, seconds, speaker \\ 1) do
    mouths =
      for t <- 0..(seconds * 1000)//40 do
        {t * @ms, %{1 => mouth(openness(t, 1), t), 2 => mouth(openness(t, 5), t)}}
      end

    voices =
      for t <- 0..(seconds * 1000)//32 do
        {(t + shift_ms) * @ms, %Voice{probability: 0.9, level: openness(t, 4 * speaker - 3)}}
      end

    {mouths, voices}
  end

  test "finds a shift in either direction to within an image, with confidence" do
    for {shift, speaker} <- [{-420, 1}, {-100, 2}, {0, 1}, {300, 2}, {480, 1}] do
      {mouths, voices} = clip(shift, 8, speaker)
      estimate = LipSync.estimate_shift(mouths, voices)
      assert_in_delta div(estimate.shift, @ms), shift, 40
      assert estimate.confidence > 0.5
      assert LipSync.out_of_sync?(estimate) == abs(shift) > 50
    end

    {mouths, voices} = clip(300, 4)
    assert LipSync.estimate_shift(mouths, voices) == LipSync.estimate_shift(mouths, voices)
  end

  test "an unseen speaker, a large shift, a short clip and silence give no reliable shift" do
    {mouths, voices} = clip(300, 8)
    {_, other} = clip(300, 8, 3)
    refute LipSync.out_of_sync?(LipSync.estimate_shift(mouths, other))
    {_, far} = clip(1_700, 8)
    refute LipSync.out_of_sync?(LipSync.estimate_shift(mouths, far))
    {short, _} = clip(300, 2)
    refute LipSync.out_of_sync?(LipSync.estimate_shift(short, voices))

    silent = for {t, voice} <- voices, do: {t, %{voice | probability: 0.1}}

    assert LipSync.estimate_shift(mouths, silent) == %LipSync{
             shift: 0,
             confidence: 0.0,
             windows: 0
           }

    assert LipSync.estimate_shift([], []) == %LipSync{shift: 0, confidence: 0.0, windows: 0}
    assert LipSync.estimate_shift(mouths, []).windows == 0
    assert LipSync.estimate_shift(for({t, _} <- mouths, do: {t, %{}}), voices).confidence == 0.0
  end
end
