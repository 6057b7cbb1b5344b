# Wrote the golden files of a format version: bin/situ's production build, `elixir_prod test/golden/make.exs FOLDER`.
# The files of an existing version are never made again, since old files are the point of them. A new version of a
# format gets a new folder.
Code.require_file("values.exs", __DIR__)
{:ok, _} = Application.ensure_all_started(:situ_media)

defmodule Make do
  alias Situ.{Annotation, Dataset, Message, Store}
  alias Situ.Store.Writer

  @small [first_extent: 65_536, max_extent: 131_072]
  @start 1_700_000_000_000_000_000

  def run(folder) do
    recordings = Path.join(folder, "recordings")
    File.mkdir_p!(recordings)
    write_recording("values", recordings, streams())
    write_recording("damaged", recordings, [{"Ints", Enum.to_list(1..3_000), type: :integer}])
    damage(Path.join(recordings, "damaged.0000"))
    write_segments(recordings)
    write_video(recordings)
    write_annotations(folder)
    write_edits(folder)
    write_layout(folder)
    write_frames(folder)
    write_expected(folder, ~w(values.0000 damaged.0000 split))
    write_unfinished(recordings)
  end

  defp write_recording(name, root, streams) do
    {:ok, writer} = Writer.create(name, root, @small)
    for stream <- streams, do: fill(writer, stream)
    :ok = Writer.close(writer)
  end

  defp fill(writer, {name, data, options}) do
    {:ok, stream} = Writer.stream(writer, name, options)

    stream =
      data
      |> messages()
      |> Enum.chunk_every(500)
      |> Enum.reduce(stream, fn batch, stream -> stream |> Writer.append(batch) |> elem(1) end)

    {:ok, _} = Writer.close_stream(stream, @start + length(data) * 10_000_000)
  end

  defp messages(data) do
    for {value, i} <- Enum.with_index(data, 1) do
      time = @start + i * 10_000_000
      %Message{data: value, originating_time: time, creation_time: time + 1_000, sequence_id: i}
    end
  end

  defp streams do
    image = Situ.Image.new_filled(8, 6, :rgb24, {10, 20, 30})
    {:ok, format} = Situ.AudioFormat.new(rate: 16_000, channels: 1, sample: :s16)

    [
      {"Ints", Enum.map(1..1_200, &(&1 * &1 - 600_000)),
       type: :integer, metadata: %{"unit" => "m"}},
      {"Floats", Enum.map(1..300, &(&1 / 8)), type: :float, compression: :zstd},
      {"Flags", Enum.map(1..300, &(rem(&1, 100) < 50)), type: :boolean},
      {"Texts", Enum.map(1..100, &"word #{rem(&1, 7)} äöü #{&1}"),
       type: :string, compression: :lz4},
      {"Terms",
       Enum.map(
         1..50,
         &%{"k" => &1, "list" => [1, 2.5, nil, {:a, "b"}], "big" => Integer.pow(2, 70)}
       ), []},
      {"Structs", Enum.map(1..20, &%Situ.Rect{x: &1, y: 2, width: 3, height: 4, label: "face"}),
       []},
      {"Bytes", [<<0, 255, 1>>, <<>>, :binary.copy(<<200>>, 300)], []},
      {"Large", [:binary.copy("large ", 3_000)], large: true, compression: :zstd},
      {"Images", [image], type: Situ.Image},
      {"Audio", [Situ.AudioBuffer.build_silence(format, 160)], type: Situ.AudioBuffer},
      {"Empty", [], type: :integer}
    ]
  end

  # One byte of the second chunk of data is different, so that chunk is damaged and all others are intact.
  defp damage(path) do
    file = Path.join(path, "data-000000.situ")
    bytes = File.read!(file)
    chunks = :binary.matches(bytes, "CHK2")
    {at, _} = Enum.at(chunks, 3)
    <<before::binary-size(at + 200), byte, rest::binary>> = bytes
    File.write!(file, [before, Bitwise.bxor(byte, 1), rest])
  end

  defp write_segments(root) do
    build = fn p ->
      store = Store.create(p, "split", root, split: Situ.Time.ms(100))
      p |> Situ.from_enumerable(1..30, every: Situ.Time.ms(10)) |> Store.write(store, "Numbers")
    end

    {:ok, _} = Situ.Pipeline.run(build)
  end

  defp write_annotations(folder) do
    {:ok, schema} =
      Annotation.Schema.parse(%{
        "name" => "Speech",
        "attributes" => [%{"name" => "speaks", "kind" => "finite", "values" => ["yes", "no"]}]
      })

    annotations = [
      Annotation.new(@start, @start + 500_000_000, "Ada", %{"speaks" => "yes"}, by: "ada"),
      Annotation.new(@start + 600_000_000, @start + 900_000_000, "Ben", %{"speaks" => "no"},
        confidence: 0.75,
        proposed?: true,
        note: "quiet"
      )
    ]

    {:ok, layer} = Annotation.Layer.new(schema, annotations)
    path = Path.join(folder, "recordings/annotation")
    {:ok, _} = Annotation.Recording.write(layer, path, "Annotations.Speech")
    file = Path.join(folder, "study.json")
    {:ok, dataset} = Dataset.new("Golden", file: file, tags: ["golden"], metadata: %{"age" => 31})
    {:ok, dataset} = Dataset.add_session(dataset, "first")

    {:ok, dataset} =
      Dataset.add_partition(
        dataset,
        "first",
        "Values",
        Path.join(folder, "recordings/values.0000")
      )

    {:ok, dataset} = Dataset.add_partition(dataset, "first", "Annotations", path <> ".0000")
    {:ok, _} = Dataset.save(dataset)
  end

  # The layout of version 1, in the present form.
  defp write_layout(folder) do
    alias Situ.Studio.Layout.Json

    {:ok, layout} = __DIR__ |> Path.join("1/layout.json") |> File.read!() |> Json.parse_json()
    File.write!(Path.join(folder, "layout.json"), Json.to_json(layout))
  end

  # Ten images as video packets: a bright square that moves to the right.
  defp write_video(root) do
    picture = fn i ->
      Situ.ImageOps.fill_rectangle!(
        Situ.Image.new_filled(96, 64, :bgr24, 40),
        {i * 8, 8, 16, 16},
        color: 220
      )
    end

    build = fn p ->
      store = Store.create(p, "video", root)

      p
      |> Situ.from_enumerable(Enum.map(0..9, picture), every: Situ.Time.ms(40))
      |> Situ.map(& &1, type: Situ.Image)
      |> Store.write(store, "Camera", encode: :h264)
    end

    {:ok, _} =
      Situ.Pipeline.run(build, pipeline: [replay: [interval: {@start, :unbounded}, speed: :max]])
  end

  # Logs of edits: of a dataset, of annotations that were not saved, and of bookmarks.
  defp write_edits(folder) do
    alias Situ.Annotation.{Editor, Layer}

    {:ok, dataset} = Dataset.open(Path.join(folder, "study.json"))
    {:ok, dataset} = Dataset.update(dataset, &Dataset.add_session(&1, "second"), by: "ada")
    {:ok, _} = Dataset.update(dataset, &Dataset.rename_session(&1, "second", "last"), by: "ben")

    path = Path.join(folder, "recordings/edited")
    schema = Annotation.Schema.text("Notes")
    {:ok, editor} = Editor.start_link(path: path, stream: "Notes", schema: schema)
    {:ok, _} = Editor.edit(editor, &Layer.add(&1, Annotation.new(@start, @start + 10, "Ada")))
    {:ok, _} = Editor.save(editor)
    {:ok, _} = Editor.edit(editor, &Layer.add(&1, Annotation.new(@start, @start + 20, "Ben")))
    {:ok, _} = Editor.edit(editor, &Layer.add(&1, Annotation.new(@start, @start + 30, "Cy")))
    {:ok, _} = Editor.undo(editor)
    :ok = Editor.stop(editor)

    bookmark = %{
      "from" => "#{@start}",
      "to" => "#{@start + 5}",
      "text" => "look here",
      "by" => "ada"
    }

    {:ok, _} = Situ.Studio.Bookmarks.edit(Path.join(folder, "study.bookmarks"), {:add, bookmark})
  end

  # Every frame of the link protocol, version 1.
  defp write_frames(folder) do
    proof = :binary.copy(<<7>>, 32)
    map = %{"stream" => "Ints", "from" => 12}

    frames = [
      {:hello, 1, 1, :binary.copy(<<3>>, 16)},
      {:login, proof, map},
      {:welcome, proof, map},
      {:refused, %{"code" => "not_trusted", "what" => "the token is wrong"}},
      {:streams, %{"streams" => []}},
      {:subscribe, 7, map},
      {:subscribed, 7, map},
      {:unsubscribe, 7},
      {:credit, 7, 65_536},
      {:batch, 7, -5, 1_700_000_000_000_000_000, 2, "payload"},
      {:part, 7, true, "bytes"},
      {:closed, 7, 99},
      {:lost, 7, 12},
      {:ping, 1},
      {:pong, 1, 2, 3},
      {:request, 5, map},
      {:reply, 5, "bytes"}
    ]

    lines =
      for frame <- frames do
        bytes = frame |> Situ.Link.Wire.Frame.encode() |> IO.iodata_to_binary()
        %{"bytes" => Base.encode16(bytes), "frame" => Situ.GoldenValues.to_json(frame)}
      end

    File.write!(Path.join(folder, "link_frames.json"), Situ.JSON.encode_pretty(lines))
  end

  defp write_expected(folder, names) do
    recordings =
      for name <- names ++ ["annotation.0000"], into: %{} do
        options = if name == "damaged.0000", do: [skip_damage: true], else: []
        {name, Situ.GoldenValues.describe(Path.join([folder, "recordings", name]), options)}
      end

    unfinished = %{
      "Ints" =>
        Enum.map(
          messages(Enum.to_list(1..700)),
          &[&1.originating_time, &1.creation_time, &1.data]
        )
    }

    expected = Map.put(recordings, "unfinished.0000", unfinished)
    File.write!(Path.join(folder, "expected.json"), Situ.JSON.encode(expected))
  end

  # The machine halts before the store is closed.
  defp write_unfinished(root) do
    {:ok, writer} = Writer.create("unfinished", root, @small)
    {:ok, stream} = Writer.stream(writer, "Ints", type: :integer)
    {:ok, _} = Writer.append(stream, messages(Enum.to_list(1..700)))
    System.halt(0)
  end
end

Make.run(hd(System.argv()))
