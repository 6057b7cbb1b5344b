defmodule MaskFixture do
  # Images of 160 x 120 with the output of networks: two objects with boxes and masks, and a class
  # for each position.
  alias Situ.{Image, Message, Rect}
  alias Situ.Studio.History

  @t0 1_767_225_600_000_000_000

  def found do
    history = History.new(seconds: 3_600, live: false)

    for i <- 0..9 do
      put(history, "Camera.Image", i, Image.new_filled(160, 120, :rgb24, [20, 20, 20]))

      put(history, "Find.Boxes", i, [
        %Rect{x: 20, y: 30, width: 40, height: 40, label: "cup", score: 0.9, id: 2},
        %Rect{x: 100, y: 60, width: 20, height: 40, label: "fork", score: 0.7, id: 3}
      ])

      put(history, "Find.Masks", i, [left_half(8, 8), Image.new_filled(4, 8, :gray8, [255])])
      put(history, "Classes", i, classes())
    end

    history
  end

  defp put(history, stream, second, data) do
    time = @t0 + second * 1_000_000_000

    History.put(
      history,
      stream,
      %Message{data: data, originating_time: time, creation_time: time},
      8
    )
  end

  defp left_half(w, h) do
    row = for x <- 0..(w - 1), into: <<>>, do: if(x < div(w, 2), do: <<255>>, else: <<0>>)
    Image.new!(width: w, height: h, format: :gray8, data: :binary.copy(row, h))
  end

  # The output of a network that received the square around the image: 32 x 32 for 160 x 160,
  # starting 20 pixels above the image. Class 5 fills the upper half of the image.
  defp classes do
    rows =
      for y <- 0..31, into: <<>>, do: :binary.copy(if(y in 4..15, do: <<5>>, else: <<0>>), 32)

    Image.new!(width: 32, height: 32, format: :gray8, data: rows)
  end
end
