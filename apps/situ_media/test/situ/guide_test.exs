defmodule Situ.Media.PicturesGuideTest do
  # Runs the code blocks of docs/guides/pictures-and-sound.md, compares their results, and compares the images they
  # draw with those on the page. SITU_PICTURES=write updates the images.
  use ExUnit.Case, async: true
  alias Situ.ImageOps

  @guides Path.expand("../../../../docs/guides", __DIR__)
  @pictures Path.join(@guides, "pictures-and-sound")

  @tag :tmp_dir
  test "every block of the guide runs and draws the images of the page", %{tmp_dir: tmp} do
    text = File.read!(Path.join(@guides, "pictures-and-sound.md"))
    write? = System.get_env("SITU_PICTURES") == "write"
    out = if write?, do: @pictures, else: tmp

    assert Situ.Test.GuideRunner.run_blocks(@guides <> "/pictures-and-sound.md",
             bindings: [folder: @pictures, out: out]
           ) > 10

    shown = Regex.scan(~r/\]\(pictures-and-sound\/(.*?)\)/, text, capture: :all_but_first)
    made = Enum.reject(List.flatten(shown), &(&1 == "astronaut.jpg"))
    assert length(made) == 5

    for name <- made do
      page = ImageOps.read!(Path.join(@pictures, name))
      fresh = ImageOps.read!(Path.join(out, name))

      # Releases of OpenCV and libjpeg-turbo differ in details; an incorrect operator differs everywhere.
      {:ok, %{mean: mean}} = ImageOps.compare(page, fresh)
      assert mean < 1.0, "#{name} is out of date"
    end
  end
end
