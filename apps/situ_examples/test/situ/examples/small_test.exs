defmodule Situ.Examples.SmallTest do
  use ExUnit.Case, async: true

  doctest Situ.Examples.Rectangles

  alias Situ.Examples.{FaceRegions, ImageCrop, ImuFusion}
  alias Situ.{Image, Rect}

  test "ImageCrop crops to the received rectangle" do
    image = Image.new!(width: 3, height: 1, format: :gray8, data: <<1, 2, 3>>)
    {:ok, state} = ImageCrop.init([])
    message = fn time, data -> %Situ.Message{originating_time: time, data: data} end
    {[], state} = ImageCrop.handle_message(:image, message.(1, image), nil, state)
    {[], state} = ImageCrop.handle_message(:rect, message.(2, Rect.new!(1, 0, 2, 1)), nil, state)
    {[{:out, 3, part}], _} = ImageCrop.handle_message(:image, message.(3, image), nil, state)
    assert Image.pixel_bytes(part) == <<2, 3>>
    outside = Rect.new!(9, 9, 1, 1)
    assert {[], _} = ImageCrop.handle_message(:image, message.(4, image), nil, outside)
  end

  test "ImuFusion emits one message per acceleration within the magnetometer's span" do
    parent = self()
    assert {:ok, %{errors: []}} = Situ.Pipeline.run(ImuFusion, each: &send(parent, {:fused, &1}))
    fused = receive_all()

    # 512 rows of the accelerometer, except those before the first and after the last row of the magnetometer.
    assert length(fused) in 480..512

    strengths = for f <- fused, do: :math.sqrt(Enum.sum(Enum.map(f.acceleration, &(&1 * &1))))
    # The sensor is shaken at times, but measures gravity most of the time.
    assert_in_delta strengths |> Enum.sort() |> Enum.at(div(length(strengths), 2)), 1.0, 0.1
    assert Enum.all?(fused, &(&1.heading >= -180.0 and &1.heading <= 180.0))

    assert List.last(fused).temperature > 20.0
    assert hd(fused).temperature == nil
  end

  test "FaceRegions opens a branch for each face and closes it when the face has gone" do
    picture = Image.new_filled(20, 10, :gray8, 100)

    face = fn id, x ->
      %Situ.Infer.Face{rect: %{Rect.new!(x, 0, 5, 5) | id: id}, eyes: {{0, 0}, {1, 0}}}
    end

    faces = [[face.(0, 0)], [face.(0, 0), face.(1, 10)], [face.(1, 10)]]

    at = fn list ->
      list |> Enum.with_index() |> Enum.map(fn {x, i} -> {i * 40_000_000, x} end)
    end

    assert [%{0 => 100.0} = one, %{0 => 100.0, 1 => 100.0}, %{1 => 100.0} = three] =
             Situ.to_list(fn p ->
               pictures = Situ.from_enumerable(p, at.([picture, picture, picture]), type: Image)
               found = Situ.from_enumerable(p, at.(faces), type: {:list, Situ.Infer.Face})
               FaceRegions.face_brightness(pictures, found)
             end)

    assert map_size(one) == 1 and map_size(three) == 1
  end

  defp receive_all do
    receive do
      {:fused, f} -> [f | receive_all()]
    after
      0 -> []
    end
  end
end
