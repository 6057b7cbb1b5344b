defmodule Situ.Infer.Face.SearchTest do
  use ExUnit.Case, async: true

  alias Situ.Infer.{Face, Patch}
  alias Situ.Infer.Face.Search
  alias Situ.Rect

  @size {1024, 512}

  # Looks into a world of faces: one is seen where it fills a sixth of the view or more and its middle is inside. Each
  # look is told to the test.
  defp look(faces, test \\ self()) do
    fn patch, min_score ->
      {left, top} = Patch.to_picture(patch, {0.0, 0.0})
      {right, _} = Patch.to_picture(patch, {patch.size * 1.0, 0.0})
      view = Rect.new!(left, top, right - left, right - left)
      send(test, {:look, view})

      {:ok,
       for face <- faces,
           face.rect.score >= min_score,
           face.rect.width >= view.width / 6,
           Rect.contains?(view, Rect.center(face.rect)) do
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
      {:ok, found, search} = Search.step(search, @size, i * 40, look(faces))
      {{looks(), found |> Enum.map(& &1.rect.x) |> Enum.sort()}, search}
    end)
  end

  test "faces that rest cost a third of the looks, and are found in every picture" do
    world = [face(100.0, 100.0, 150.0), face(700.0, 120.0, 160.0)]
    {steps, _} = run(search(), List.duplicate(world, 10))
    assert Enum.all?(steps, fn {_, found} -> found == [100.0, 700.0] end)

    # Everything; the whole, both closely and a tile; then a tile, a tile, the whole and both closely.
    assert Enum.map(steps, &elem(&1, 0)) |> Enum.drop(1) == [4, 1, 1, 3, 1, 1, 3, 1, 1]
  end

  test "faces that move are looked for in every picture" do
    worlds = for i <- 0..9, do: [face(100.0 + 20 * i, 100.0, 150.0)]
    {steps, _} = run(search(), worlds)
    assert Enum.map(steps, &elem(&1, 1)) == for(i <- 0..9, do: [100.0 + 20 * i])
    assert Enum.map(steps, &elem(&1, 0)) |> Enum.drop(1) |> Enum.uniq() == [3]
  end

  test "a face that comes while others rest is seen within two rounds" do
    resting = face(100.0, 100.0, 150.0)

    worlds =
      List.duplicate([resting], 5) ++ List.duplicate([resting, face(800.0, 300.0, 50.0)], 60)

    {steps, _} = run(search(), worlds)
    assert [100.0, 800.0] == elem(List.last(steps), 1)
  end

  test "people together are not one large face" do
    group = face(300.0, 50.0, 400.0, 0.6)
    people = for x <- [320.0, 450.0, 600.0], do: face(x, 200.0, 60.0)
    {[{_, found}], _} = run(search(), [[group | people]])
    assert found == [320.0, 450.0, 600.0]
  end

  test "clocks that go back and pictures of other sizes begin again" do
    {_, search} = run(search(), List.duplicate([face(100.0, 100.0, 150.0)], 4))
    assert {:ok, [], search} = Search.step(search, {640, 480}, 0, look([]))
    assert {:ok, [_], _} = Search.step(search, {640, 480}, -1_000, look([face(9.0, 9.0, 200.0)]))
  end

  test "an error of a look is the answer" do
    error = Situ.Error.new(:model_failed, "no")
    assert Search.step(search(), @size, 0, fn _, _ -> {:error, error} end) == {:error, error}
  end
end
