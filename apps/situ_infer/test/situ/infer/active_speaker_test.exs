defmodule Situ.Infer.ActiveSpeakerTest do
  use ExUnit.Case, async: true
  alias Situ.Infer.{ActiveSpeaker, Mouth, Voice}

  # 25 images a second; `lips` and `voice` are functions of the image's number.
  defp decide(n, lips, voice) do
    {decisions, {speaker, _}} =
      Enum.flat_map_reduce(0..(n - 1), {ActiveSpeaker.new(), %{}}, fn i, {speaker, known} ->
        time = i * 40_000_000

        mouths =
          Map.new(lips.(i), fn {id, o} -> {id, Mouth.track_opening(known[id], time, o)} end)

        {p, level} = voice.(i)

        {out, speaker} =
          ActiveSpeaker.push(speaker, time, mouths, %Voice{probability: p, level: level})

        {out, {speaker, mouths}}
      end)

    {last, _} = ActiveSpeaker.close(speaker)
    Enum.map(decisions ++ last, fn {_, map} -> for({id, true} <- map, do: id) end)
  end

  defp wave(i), do: abs(:math.sin(i * 0.7))
  defp talk(i) when i in 25..60, do: {1.0, 0.05 + 0.2 * wave(i)}
  defp talk(_), do: {0.0, 0.001}

  test "the face whose lips follow the voice is the speaker" do
    lips = fn i -> %{0 => 0.1, 1 => if(i in 25..60, do: 0.05 + 0.1 * wave(i), else: 0.05)} end
    said = decide(90, lips, &talk/1)
    assert length(said) == 90
    assert Enum.slice(said, 30, 30) |> Enum.uniq() == [[1]]
    assert (Enum.slice(said, 0, 20) ++ Enum.slice(said, 67, 23)) |> Enum.uniq() == [[]]
  end

  test "an off-screen voice and lips that move in silence belong to no face" do
    still = fn _ -> %{0 => 0.1, 1 => 0.2} end
    assert decide(90, still, &talk/1) |> Enum.uniq() == [[]]
    chewing = fn i -> %{0 => 0.1 + 0.1 * wave(i)} end
    assert decide(90, chewing, fn _ -> {0.0, 0.001} end) |> Enum.uniq() == [[]]
  end

  # Face 0 speaks, then rests with its mouth slightly open; then someone outside the image speaks.
  test "a mouth that stays open is not the speaker of another voice" do
    lips = fn i ->
      %{
        0 =>
          cond do
            i < 25 -> 0.05
            i <= 60 -> 0.05 + 0.1 * wave(i)
            true -> 0.09 + 0.004 * wave(i)
          end
      }
    end

    outside = fn i -> if i in 84..110, do: {1.0, 0.05 + 0.2 * wave(3 * i)}, else: talk(i) end
    said = decide(120, lips, outside)
    assert Enum.slice(said, 30, 30) |> Enum.uniq() == [[0]]
    assert Enum.slice(said, 70, 50) |> Enum.uniq() == [[]]
  end

  test "a chewing mouth is soon distinguished from the speaker's" do
    voice = fn i -> if i in 25..110, do: {1.0, 0.05 + 0.2 * wave(i)}, else: {0.0, 0.001} end
    bite = fn i -> if i in 18..110, do: abs(:math.sin(i * 0.39)), else: 0.0 end
    said = decide(130, fn i -> %{0 => 0.05 + 0.1 * bite.(i)} end, voice)
    assert Enum.slice(said, 62, 68) |> Enum.uniq() == [[]]

    # Lips that stay open and match nothing prove nothing: a mesh says little about how wide an open mouth is.
    open = fn i -> if i in 25..110, do: 0.16 + 0.04 * :math.sin(i * 1.9), else: 0.05 end
    said = decide(130, fn i -> %{0 => open.(i)} end, voice)
    assert Enum.slice(said, 35, 70) |> Enum.uniq() == [[0]]
  end

  test "no faces and no audio are not an error" do
    assert decide(10, fn _ -> %{} end, &talk/1) |> Enum.uniq() == [[]]
    {out, speaker} = ActiveSpeaker.push(ActiveSpeaker.new(), 0, %{}, nil)
    assert {[{0, %{}}], _} = {out ++ elem(ActiveSpeaker.close(speaker), 0), nil}
  end
end
