defmodule Situ.Media.GoldenFilesTest do
  # Decodes the video recordings of test/golden, which every later version must be able to read.
  use ExUnit.Case, async: true

  alias Situ.{Image, ImageOps, Store}

  @files Path.wildcard(Path.expand("../../../../../test/golden/*/recordings/video.0000", __DIR__))
  @start 1_700_000_000_000_000_000

  test "there are golden videos" do
    assert @files != []
  end

  for file <- @files do
    test "#{file |> Path.split() |> Enum.at(-3)}: ten images come back with their times" do
      messages = unquote(file) |> Store.open!() |> Store.messages("Camera") |> Enum.to_list()

      assert Enum.map(messages, & &1.originating_time) ==
               for(i <- 0..9, do: @start + i * 40_000_000)

      for {message, i} <- Enum.with_index(messages) do
        square =
          ImageOps.fill_rectangle!(
            Image.new_filled(96, 64, :bgr24, 40),
            {i * 8, 8, 16, 16},
            color: 220
          )

        assert {:ok, %{mean: mean}} = ImageOps.compare(message.data, square)
        assert mean < 2
      end
    end
  end
end
