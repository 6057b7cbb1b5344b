defmodule Situ.Studio.PageExportTest do
  # Exports pages from recorded messages and reads their data back.
  use ExUnit.Case, async: true
  doctest Situ.Studio.PageExport.Contents

  alias Situ.{AudioBuffer, AudioFormat, Image, Message}
  alias Situ.Studio.{History, PageExport, Recordings}

  @ms 1_000_000
  @s 1_000_000_000

  defp source do
    history = History.new(live: false, seconds: 3_600)

    put = fn name, time, data ->
      History.put(history, name, %Message{data: data, originating_time: time}, 8)
    end

    for i <- 0..2_999, do: put.("Level", i * @ms, i / 7)
    for i <- 0..2, do: put.("State", i * @s, Enum.at([:idle, :moving, :idle], i))

    for i <- 0..449,
        do: put.("Camera", i * 5 * @ms, Image.new_filled(1_280, 96, :rgb24, [9, 9, 9]))

    put.("Name", 0, "<script>alert(1)</script>")
    for i <- 0..9, do: put.("Way", i * @ms, %Situ.GeoPoint{latitude: 45.0, longitude: i / 1})

    buffer = %AudioBuffer{
      format: AudioFormat.pcm(16_000, 1),
      data: <<1::16-little>> |> :binary.copy(8_000)
    }

    for i <- 1..6, do: put.("Mic", i * 500 * @ms, buffer)
    Recordings.History.wrap(history)
  end

  defp export(source, from, to, streams \\ :automatic) do
    {:ok, export} = PageExport.new(source, "a <talk>", {from, to}, streams)
    export
  end

  # Returns the list of contents, the reply with all frames, and the sounds.
  defp unpack(page) do
    [_, text] = Regex.run(~r|<script type="text/plain" id="situ-data">([^<]*)</script>|, page)
    data = text |> Base.decode64!() |> :zlib.gunzip()
    <<list_size::little-64, reply_size::little-64, rest::binary>> = data
    padded = fn bytes -> div(bytes + 7, 8) * 8 end
    reply_at = padded.(list_size)
    sounds_at = reply_at + padded.(reply_size)
    {:ok, list} = rest |> binary_part(0, list_size) |> Situ.JSON.decode()
    reply = binary_part(rest, reply_at, reply_size)
    sounds = binary_part(rest, sounds_at, byte_size(rest) - sounds_at)
    {list, reply, sounds}
  end

  test "a page has the messages of all of its streams, and allows no request" do
    source = source()

    assert {:ok, page, notes} =
             PageExport.build_page(export(source, 0, 3 * @s), source, fn _ -> :ok end)

    {list, reply, sounds} = unpack(page)
    entries = Map.new(list["entries"], &{{&1["stream"], &1["viz"]}, &1})

    # 3,000 messages are in three parts, each with all of its messages.
    assert length(entries[{"Level", "line"}]["windows"]) == 3
    assert [%{"at" => "0", "rate" => 16_000, "channels" => 1, "count" => 48_000}] = list["sounds"]
    assert byte_size(sounds) == 96_000
    assert sounds |> binary_part(0, 2) == <<1::little-16>>
    assert <<1, _, _flags::16, 0::little-32, 0::little-64, from_to::little-64, _::binary>> = reply
    assert from_to == 3 * @s

    assert page =~ "default-src &#39;none&#39;"
    assert page =~ "a &lt;talk&gt;"
    refute page =~ "<script>alert"

    assert Regex.scan(~r/<(?:link|script|img)[^>]* (?:src|href)="[^"]*"/, page) == [
             [~s(<link rel="icon" href="data:,")]
           ]

    # A map shows the way, and the position at the cursor.
    assert %{"windows" => [way], "instants" => places} = entries[{"Way", "map"}]
    assert length(places) == 10 and way not in places

    # Of 450 images, every second is kept, and made smaller.
    assert length(entries[{"Camera", "image"}]["instants"]) == 225
    assert "Camera: 225 of 450 messages, evenly spaced." in notes
    assert byte_size(page) < 2_000_000
  end

  test "a part of the time and of the streams" do
    source = source()
    export = export(source, @s, @s + 99 * @ms, ["Level"])
    assert PageExport.list_streams(export) == ["Level"]
    assert {:ok, page, []} = PageExport.build_page(export, source, fn _ -> :ok end)
    {%{"entries" => [entry], "sounds" => []}, reply, ""} = unpack(page)
    assert entry["windows"] == [0]
    # A series of 100 messages and one on each side.
    assert <<_::binary-size(40), 1::little-16, 1::little-16, _::64, 102::little-32, _::binary>> =
             reply
  end

  test "all chosen streams are on the page, although an automatic layout leaves some out" do
    history = History.new(live: false, seconds: 3_600)
    names = for i <- 1..50, do: "S#{i}.Value"

    for name <- names,
        t <- [0, @s],
        do: History.put(history, name, %Message{data: 1.0, originating_time: t}, 8)

    source = Recordings.History.wrap(history)
    assert length(PageExport.list_streams(export(source, 0, @s))) < 50
    export = export(source, 0, @s, names)
    assert Enum.sort(PageExport.list_streams(export)) == Enum.sort(names)
  end

  @tag :tmp_dir
  test "writes a file, and refuses a page without streams", %{tmp_dir: dir} do
    source = source()
    path = Path.join(dir, "page.html")
    export = export(source, 0, @s, ["State"])
    assert {:ok, bytes, []} = PageExport.write_page(export, source, path, fn _ -> :ok end)
    assert File.stat!(path).size == bytes

    none = PageExport.keep_streams(export, ["Other"])
    assert {:error, %{code: :no_streams}} = PageExport.build_page(none, source, fn _ -> :ok end)

    assert {:error, %{code: :not_saved}} =
             PageExport.write_page(export, source, dir, fn _ -> :ok end)
  end
end
