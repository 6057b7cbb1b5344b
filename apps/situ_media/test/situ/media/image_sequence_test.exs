defmodule Situ.Media.ImageSequenceTest do
  use ExUnit.Case, async: true

  import Situ.Media.TestFiles, only: [path: 1]
  import Situ.Media.TestPipelines
  alias Situ.{Image, ImageOps, Time}
  alias Situ.Media.{ImageSequence, ImageSequenceWriter, VideoFile}

  doctest Situ.Media.ImageSequence

  @moduletag :tmp_dir
  @recorded 1_700_000_000_000_000_000

  defp write_shots(folder, opts) do
    {{:ok, _}, %{out: out}} =
      collect(fn p ->
        clip =
          VideoFile.open(p, path("talk1.mp4"),
            size: {32, 16},
            audio: false,
            end: Time.ms(400),
            start_time: @recorded
          )

        %{out: ImageSequenceWriter.write(clip.video, folder, opts)}
      end)

    out
  end

  test "images keep their originating times", %{tmp_dir: dir} do
    folder = Path.join(dir, "shots")
    written = write_shots(folder, type: :png)
    assert length(written) == 10
    {{:ok, _}, %{out: read}} = collect(&%{out: ImageSequence.open(&1, folder, format: :bgr24)})
    assert read == written
  end

  test "JPEG files are smaller and nearly identical", %{tmp_dir: dir} do
    folder = Path.join(dir, "shots")
    written = write_shots(folder, quality: 95)
    assert File.exists?(Path.join(folder, "000010.jpg"))
    {{:ok, _}, %{out: read}} = collect(&%{out: ImageSequence.open(&1, folder)})
    assert Enum.map(read, &elem(&1, 0)) == Enum.map(written, &elem(&1, 0))
    {_, %Image{width: 32, height: 16, format: :bgr24}} = hd(read)
  end

  test "a pattern or a list needs a rate, and files are ordered by number", %{tmp_dir: dir} do
    for n <- 1..12,
        do: :ok = ImageOps.write(Image.new_filled(4, 4, :gray8, n), Path.join(dir, "s#{n}.png"))

    open = fn files, opts -> fn p -> %{out: ImageSequence.open(p, files, opts)} end end

    {{:ok, _}, %{out: read}} = collect(open.(Path.join(dir, "s*.png"), rate: 10))

    assert for({t, i} <- read, do: {t, hd(:binary.bin_to_list(i.data))}) ==
             for(n <- 1..12, do: {(n - 1) * Time.ms(100), n})

    files = for n <- [3, 1], do: Path.join(dir, "s#{n}.png")
    {{:ok, _}, %{out: read}} = collect(open.(files, start_time: 50, rate: 50))
    assert [{50, %{data: <<3, _::binary>>}}, {20_000_050, %{data: <<1, _::binary>>}}] = read
  end

  @tag :capture_log
  test "an unreadable image ends with an error or is skipped", %{tmp_dir: dir} do
    for n <- 1..3,
        do: :ok = ImageOps.write(Image.new_filled(4, 4, :gray8, n), Path.join(dir, "#{n}.png"))

    File.write!(Path.join(dir, "2.png"), binary_part(File.read!(Path.join(dir, "2.png")), 0, 40))
    open = fn opts -> fn p -> %{out: ImageSequence.open(p, dir, opts)} end end

    assert {{:error, %{code: :bad_png}}, %{out: [{0, _}]}} = collect(open.([]))
    assert {{:ok, _}, %{out: [{0, _}, {80_000_000, _}]}} = collect(open.(on_damage: :skip))
  end

  @tag :capture_log
  test "overwrites no files and rejects an invalid index", %{tmp_dir: dir} do
    folder = Path.join(dir, "shots")
    write_shots(folder, [])

    assert {:error, %{code: :exists}} =
             Situ.Pipeline.run(fn p ->
               p |> ImageSequence.open(folder) |> ImageSequenceWriter.write(folder)
             end)

    for bad <- [
          "x",
          "file,originating_time\n../../etc/passwd,1\n",
          "file,originating_time\na.jpg,2\nb.jpg,2\n"
        ] do
      File.write!(Path.join(folder, "times.csv"), bad)
      assert {:error, %{code: :bad_index}} = Situ.Pipeline.run(&ImageSequence.open(&1, folder))
    end

    assert {:error, %{code: :no_file}} = Situ.Pipeline.run(&ImageSequence.open(&1, dir))
  end
end
