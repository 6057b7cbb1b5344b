defmodule Situ.Infer.FaceTest do
  use ExUnit.Case, async: true

  alias Situ.{Image, Imaging, Rect}
  alias Situ.Infer.{ActiveSpeaker, FaceDetector, FaceLandmarks, FaceTracker, Mouth, Patch, Voice}

  @fixtures Path.expand("../../fixtures", __DIR__)

  defp picture(name) do
    {:ok, image} = Imaging.read(Path.join(@fixtures, name))
    image
  end

  test "finds the one face of the photo, and its points" do
    image = picture("astronaut.png")
    assert {:ok, [face]} = FaceDetector.detect(image)
    assert Rect.iou(face.rect, Rect.new!(178, 82, 93, 92)) > 0.6

    {:ok, model} = FaceLandmarks.load([])
    assert {:ok, [mesh]} = FaceLandmarks.find(model, image, [face])
    assert mesh.score > 0.9
    {x, y} = Situ.Infer.FaceMesh.point(mesh, 13)
    assert_in_delta x, 223, 15
    assert_in_delta y, 143, 15
    assert Mouth.opening(mesh) > 0.02 and Mouth.opening(mesh) < 0.2
  end

  test "finds no face in a cup of coffee" do
    assert {:ok, []} = FaceDetector.detect(picture("coffee_noface.png"))
  end

  test "a picture of 16-bit channels is refused" do
    assert {:error, %{code: :bad_image}} = FaceDetector.detect(Image.filled(64, 64, :gray16))
  end

  test "a patch of a patch's own size is the picture" do
    image =
      Image.new!(
        width: 2,
        height: 2,
        format: :rgb24,
        data: <<1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12>>
      )

    assert {:ok, tensor} = Patch.cut(Patch.square({0.0, 0.0}, 2.0, 2), image, 1.0, 0.0)
    assert Situ.Tensor.to_list(tensor) == Enum.map(1..12, &(&1 * 1.0))
  end

  test "a face that returns in time keeps its id, later it gets a new one" do
    face = fn x -> %Situ.Infer.Face{rect: Rect.new!(x, 0, 10, 10), eyes: {{0, 0}, {1, 0}}} end
    tracker = FaceTracker.new(max_missing: 100)
    {[a], tracker} = FaceTracker.step(tracker, 0, [face.(0)])
    {[], tracker} = FaceTracker.step(tracker, 50, [])
    {[b], tracker} = FaceTracker.step(tracker, 90, [face.(2)])
    {[], tracker} = FaceTracker.step(tracker, 150, [])
    {[c], _} = FaceTracker.step(tracker, 250, [face.(2)])
    assert [a.rect.id, b.rect.id, c.rect.id] == [0, 0, 1]
  end

  describe "ActiveSpeaker" do
    # 25 pictures a second; `lips` and `voice` are functions of the picture's number.
    defp decide(n, lips, voice) do
      {decisions, {speaker, _}} =
        Enum.flat_map_reduce(0..(n - 1), {ActiveSpeaker.new(), %{}}, fn i, {speaker, known} ->
          time = i * 40_000_000
          mouths = Map.new(lips.(i), fn {id, o} -> {id, Mouth.watch(known[id], time, o)} end)
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

    test "the face whose lips follow the voice speaks" do
      lips = fn i -> %{0 => 0.1, 1 => if(i in 25..60, do: 0.05 + 0.1 * wave(i), else: 0.05)} end
      said = decide(90, lips, &talk/1)
      assert length(said) == 90
      assert Enum.slice(said, 30, 30) |> Enum.uniq() == [[1]]
      assert (Enum.slice(said, 0, 20) ++ Enum.slice(said, 67, 23)) |> Enum.uniq() == [[]]
    end

    test "a voice from outside and lips that move in silence are nobody's" do
      still = fn _ -> %{0 => 0.1, 1 => 0.2} end
      assert decide(90, still, &talk/1) |> Enum.uniq() == [[]]
      chewing = fn i -> %{0 => 0.1 + 0.1 * wave(i)} end
      assert decide(90, chewing, fn _ -> {0.0, 0.001} end) |> Enum.uniq() == [[]]
    end

    test "no faces and no sound are no error" do
      assert decide(10, fn _ -> %{} end, &talk/1) |> Enum.uniq() == [[]]
      {out, speaker} = ActiveSpeaker.push(ActiveSpeaker.new(), 0, %{}, nil)
      assert {[{0, %{}}], _} = {out ++ elem(ActiveSpeaker.close(speaker), 0), nil}
    end
  end
end
