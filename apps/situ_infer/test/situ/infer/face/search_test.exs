defmodule Situ.Infer.Face.SearchTest do
  use ExUnit.Case, async: true

  alias Situ.Infer.{Face, Patch}
  alias Situ.Infer.Face.Search
  alias Situ.Rect

  @size {1024, 512}

  # Searches a simulated world of faces: a face is found if it fills at least a sixth of the view and its center is
  # inside. Each search is reported to the test.
  defp look(faces, test \\ self()) do
    fn patch, min_score ->
      {left, top} = Patch.to_image_point(patch, {0.0, 0.0})
      {right, _} = Patch.to_image_point(patch, {patch.size * 1.0, 0.0})
      view = Rect.new!(left, top, right - left, right - left)
      send(test, {:look, view})

      {:ok,
       for face <- faces,
           face.rect.score >= min_score,
           face.rect.width >= view.width / 6,
           Rect.contains_point?(view, Rect.center_point(face.rect)) do
         face
       end}
    end
  end

  defp face(x, y, width, score \\ 0.9) do
    rect = Rect.new!(x: x, y: y, width: width, height: width, score: score)
    %Face{rect: rect, eyes: {{x, y}, {x + width, y}}}
  end

  defp looks(n \\ 0) do
    receive do
      {:look, _} -> looks(n + 1)
    after
      0 -> n
    end
  end

  defp search(opts \\ []),
    do: Search.new([min_score: 0.5, tile_score: 0.7, tiles: nil, every: 120] ++ opts)

  defp run(search, worlds) do
    Enum.map_reduce(Enum.with_index(worlds), search, fn {faces, i}, search ->
      {:ok, found, search} = Search.search_image(search, @size, i * 40, look(faces))
      {{looks(), found |> Enum.map(& &1.rect.x) |> Enum.sort()}, search}
    end)
  end

  test "still faces take a third of the searches and are found in every image" do
    world = [face(100.0, 100.0, 150.0), face(700.0, 120.0, 160.0)]
    {steps, _} = run(search(), List.duplicate(world, 10))
    assert Enum.all?(steps, fn {_, found} -> found == [100.0, 700.0] end)

    # First everything; then the whole image, both close-ups and a tile; then a tile, a tile, the whole and both
    # close-ups.
    assert Enum.map(steps, &elem(&1, 0)) |> Enum.drop(1) == [4, 1, 1, 3, 1, 1, 3, 1, 1]
  end

  test "moving faces are searched for in every image" do
    worlds = for i <- 0..9, do: [face(100.0 + 20 * i, 100.0, 150.0)]
    {steps, _} = run(search(), worlds)
    assert Enum.map(steps, &elem(&1, 1)) == for(i <- 0..9, do: [100.0 + 20 * i])
    assert Enum.map(steps, &elem(&1, 0)) |> Enum.drop(1) |> Enum.uniq() == [3]
  end

  test "a face that appears while others are still is found within two rounds" do
    resting = face(100.0, 100.0, 150.0)

    worlds =
      List.duplicate([resting], 5) ++ List.duplicate([resting, face(800.0, 300.0, 50.0)], 60)

    {steps, _} = run(search(), worlds)
    assert [100.0, 800.0] == elem(List.last(steps), 1)
  end

  test "several people together are not one large face" do
    group = face(300.0, 50.0, 400.0, 0.6)
    people = for x <- [320.0, 450.0, 600.0], do: face(x, 200.0, 60.0)
    {[{_, found}], _} = run(search(), [[group | people]])
    assert found == [320.0, 450.0, 600.0]
  end

  test "starts again when the clock goes back or the image size changes" do
    {_, search} = run(search(), List.duplicate([face(100.0, 100.0, 150.0)], 4))
    assert {:ok, [], search} = Search.search_image(search, {640, 480}, 0, look([]))

    assert {:ok, [_], _} =
             Search.search_image(search, {640, 480}, -1_000, look([face(9.0, 9.0, 200.0)]))
  end

  test "returns the error of a search" do
    error = Situ.Error.new(:model_failed, "no")

    assert Search.search_image(search(), @size, 0, fn _, _ -> {:error, error} end) ==
             {:error, error}
  end
end
