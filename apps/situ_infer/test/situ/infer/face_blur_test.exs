defmodule Situ.Infer.FaceBlurTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Infer.{Face, FaceBlur}
  alias Situ.{Image, ImageOps, Message, Rect}

  doctest FaceBlur

  @ms 1_000_000

  # Lines that disappear when they are blurred.
  defp striped(width, height) do
    data = for _ <- 1..height, x <- 1..width, into: <<>>, do: <<rem(x, 2) * 255>>
    Image.new!(width: width, height: height, format: :gray8, data: data)
  end

  defp face(x, y, size), do: %Face{rect: Rect.new!(x, y, size, size), eyes: {{0, 0}, {1, 0}}}

  property "hides the face completely and leaves the rest unchanged", numtests: 100 do
    forall {x, y, w, h} <- {integer(-30, 70), integer(-30, 50), integer(8, 60), integer(8, 60)} do
      image = striped(64, 48)
      hidden = FaceBlur.hide_rects(image, [Rect.new!(x, y, w, h)])

      for row <- 0..47, column <- 0..63, reduce: true do
        ok ->
          at = row * 64 + column
          {before, now} = {:binary.at(image.data, at), :binary.at(hidden.data, at)}
          inside? = column in x..(x + w - 1) and row in y..(y + h - 1)

          # If only a narrow strip of the face is within the image, a spot spans only a line or two.
          narrow? = min(x + w, 64) - max(x, 0) < 8
          ok and if inside? and not narrow?, do: now in 40..215, else: inside? or now == before
      end
    end
  end

  test "hides a face for a margin before it is found and after it is lost" do
    image = striped(64, 64)
    faces = fn k -> if k == 5, do: [face(24, 24, 16)], else: [] end

    {:ok, state} = FaceBlur.init(hold: 200 * @ms, margin: 2.0)

    {actions, state} =
      Enum.flat_map_reduce(0..10, state, fn k, state ->
        time = k * 100 * @ms

        message = %Message{
          data: {image, faces.(k)},
          originating_time: time,
          creation_time: time,
          sequence_id: k
        }

        FaceBlur.handle_message(:in, message, %{}, state)
      end)

    {rest, _} = FaceBlur.handle_closed(:in, 0, %{}, state)
    pictures = for {:out, time, picture} <- actions ++ rest, do: {time, picture}

    for {{time, picture}, k} <- Enum.with_index(pictures) do
      assert time == k * 100 * @ms
      hidden? = k in 3..7
      part = ImageOps.crop!(picture, {20, 20, 24, 24})
      assert part.data != ImageOps.crop!(image, {20, 20, 24, 24}).data == hidden?
      assert ImageOps.crop!(picture, {0, 0, 15, 15}) == ImageOps.crop!(image, {0, 0, 15, 15})
    end

    assert length(pictures) == 11
  end
end
