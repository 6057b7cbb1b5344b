defmodule Situ.Studio.PreviewTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.{AudioBuffer, AudioFormat, DepthImage, Image, PointCloud}
  alias Situ.Studio.Preview

  doctest Preview

  # Every drawing must be well-formed, because it is put into other pages.
  defp parse!(html) do
    text = IO.iodata_to_binary(html)
    text = String.replace(text, ~r/(<img [^>]*)>/, "\\1/>")
    {document, []} = text |> String.to_charlist() |> :xmerl_scan.string(quiet: true)
    {elem(document, 1), text}
  end

  test "draws images, audio, clouds and texts" do
    {:ok, image} =
      Image.new(width: 2, height: 2, format: :rgb24, data: String.duplicate(<<9, 8, 7>>, 4))

    {:ok, depth} = DepthImage.new(width: 2, height: 1, data: <<500::little-16, 1500::little-16>>)
    for picture <- [image, depth], do: assert({:img, _} = parse!(Preview.render(picture)))
    audio = AudioBuffer.from_samples([0, 16384, -16384, 0], AudioFormat.pcm(16_000))
    assert {:div, text} = parse!(Preview.render(audio))
    assert text =~ "4 frames"
    cloud = PointCloud.from_points([{0.0, 0.0, 0.0}, {2.0, 4.0, 6.0}])
    assert {:svg, _} = parse!(Preview.render(cloud))
    assert {:svg, _} = parse!(Preview.render(%PointCloud{points: ""}))
    assert {:pre, text} = parse!(Preview.render("<script>"))
    refute text =~ "<script>"
    assert {:pre, _} = parse!(Preview.render(<<255, 254>>))
    assert {:pre, _} = parse!(Preview.render(%{a: make_ref()}))
  end

  property "every series gives a well-formed plot", numtests: 100 do
    forall values <-
             list(
               :proper_types.union([:proper_types.float(), :proper_types.integer(-5, 5), :nan])
             ) do
      # Times are far from zero, where floats are coarse.
      points = for {v, i} <- Enum.with_index(values), do: {1_795_751_977_445_545_508 + i, v}
      {:svg, _} = parse!(Preview.plot([{"a<b", points}, {"", Enum.take(points, 1)}]))
      true
    end
  end

  test "a single value is drawn, however large it is" do
    for v <- [
          0,
          7,
          1.5,
          1.0e17,
          1.7e308,
          -1.7e290,
          Integer.pow(10, 400),
          1_795_751_977_445_545_508
        ],
        do: assert({:svg, _} = parse!(Preview.plot([{"", [{1_795_751_977_445_545_508, v}]}])))
  end

  @tag :tmp_dir
  test "draws the timeline of a recording, with signals as lines and marks for the others", %{
    tmp_dir: dir
  } do
    {:ok, _} =
      Situ.Pipeline.run(
        fn p ->
          store = Situ.Store.create(p, "lab", dir)

          p
          |> Situ.from_enumerable([1.0, 2.5, 2.0], every: 10, name: "Level")
          |> Situ.Store.write(store, "Level")

          p
          |> Situ.from_enumerable(["a", "b"], every: 10)
          |> Situ.Store.write(store, "Words & more")
        end,
        pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
      )

    {:ok, recording} = Situ.Store.open(Path.join(dir, "lab"))
    {:ok, svg} = Preview.timeline(recording)
    assert {:svg, text} = parse!(svg)
    assert text =~ "Level"
    assert text =~ "Words &amp; more"
    assert length(Regex.scan(~r/v14/, text)) == 2
  end
end
