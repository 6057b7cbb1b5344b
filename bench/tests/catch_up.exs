defmodule Situ.Bench.CatchUp do
  # A viewer that connects late or reconnects: how many times faster than real time a recording of
  # images and audio reaches it, and how long it takes after an interruption to catch up with the
  # ongoing recording.
  alias Situ.{Message, Link}
  alias Situ.Link.Server
  alias Situ.Store.Writer

  @fps 30
  # 10 MB per second.
  @piece 100_000
  @pieces_per_s 100

  def tests do
    [
      {"link-catch-up-720p", &recording(max(2, round(60 * &1)))},
      {"link-catch-up-cut", &cut(max(2, round(60 * &1)))}
    ]
  end

  # JPEG images of 1280 x 720 and audio at 16 kHz.
  defp recording(seconds) do
    {root, writer} = recorder()
    {:ok, video} = Writer.stream(writer, "video")
    {:ok, sound} = Writer.stream(writer, "sound")
    picture = picture()
    samples = :binary.copy(<<0, 1>>, 16_000)

    {video, sound} =
      Enum.reduce(0..(seconds - 1), {video, sound}, fn s, {video, sound} ->
        frames = for i <- 1..@fps, do: message(s * @fps + i, div(1_000_000_000, @fps), picture)
        {:ok, video} = Writer.append(video, frames)
        {:ok, sound} = Writer.append(sound, [message(s + 1, 1_000_000_000, samples)])
        {video, sound}
      end)

    {:ok, _} = Writer.close_stream(video, seconds * 1_000_000_000)
    {:ok, _} = Writer.close_stream(sound, seconds * 1_000_000_000)
    :ok = Writer.close(writer)
    {:ok, server} = Link.serve(writer.path, port: 0)
    counter = :counters.new(1, [])

    try do
      metrics =
        Situ.Bench.measure("link_catch_up_720p", seconds, "x", fn ->
          {:ok, _} =
            Situ.Pipeline.run(
              fn p ->
                link = Link.open(p, address(server), from: :start)

                for name <- ["video", "sound"] do
                  link
                  |> Link.stream(name)
                  |> Situ.each(fn _ -> :counters.add(counter, 1, 1) end)
                end
              end,
              pipeline: [replay: [speed: :max]]
            )

          []
        end)

      true = :counters.get(counter, 1) == seconds * (@fps + 1)
      metrics ++ [{"link_catch_up_720p_frame", byte_size(picture.data) / 1.0e3, "KB"}]
    after
      Server.close(server)
      File.rm_rf!(root)
    end
  end

  # Noise on a ramp compresses to the size of a photograph, not of a drawing.
  defp picture do
    row = for x <- 0..1279, into: <<>>, do: <<div(x, 5), div(x, 6), div(x, 7)>>
    noise = for <<b <- :rand.bytes(1280 * 3)>>, into: <<>>, do: <<rem(b, 24)>>

    line =
      for {a, b} <- Enum.zip(:binary.bin_to_list(row), :binary.bin_to_list(noise)),
          into: <<>>,
          do: <<min(a + b, 255)>>

    image =
      Situ.Image.new!(width: 1280, height: 720, format: :bgr24, data: :binary.copy(line, 720))

    {:ok, jpeg} = Situ.ImageOps.encode_jpeg(image, quality: 85)
    jpeg
  end

  defp cut(seconds) do
    {root, writer} = recorder()
    {:ok, stream} = Writer.stream(writer, "pieces")
    {:ok, server} = Link.serve(writer.path, port: 0)
    {port, made, seen} = {Server.port(server), :counters.new(1, []), :counters.new(1, [])}
    started = System.monotonic_time(:millisecond)
    recording = Task.async(fn -> record(stream, made, started, 0) end)

    {:ok, viewer} =
      Situ.Pipeline.start(fn p ->
        p
        |> Link.open("situ://127.0.0.1:#{port}", from: :start)
        |> Link.stream("pieces")
        |> Situ.each(fn _ -> :counters.add(seen, 1, 1) end)
      end)

    try do
      until(fn -> abreast?(made, seen) and :counters.get(made, 1) > 10 end)
      Server.close(server)
      Process.sleep(seconds * 1_000)
      missing = :counters.get(made, 1) - :counters.get(seen, 1)
      {:ok, server} = Link.serve(writer.path, port: port)
      since = System.monotonic_time(:millisecond)
      until(fn -> abreast?(made, seen) end)
      took = (System.monotonic_time(:millisecond) - since) / 1.0e3

      for pid <- [recording.pid, viewer] do
        Process.unlink(pid)
        Process.exit(pid, :kill)
      end

      Server.close(server)

      [
        {"link_catch_up_cut", took, "s"},
        {"link_catch_up_cut_missing", missing * @piece / 1.0e6, "MB"}
      ]
    after
      File.rm_rf!(root)
    end
  end

  # Within a fifth of a second counts as caught up.
  defp abreast?(made, seen), do: :counters.get(made, 1) - :counters.get(seen, 1) <= 20

  defp until(fun) do
    unless fun.() do
      Process.sleep(10)
      until(fun)
    end
  end

  # Emits as many messages as the elapsed time requires, every 20 ms.
  defp record(stream, made, started, n) do
    due = div((System.monotonic_time(:millisecond) - started) * @pieces_per_s, 1_000)
    data = :rand.bytes(@piece)
    messages = for i <- (n + 1)..due//1, do: message(i, div(1_000_000_000, @pieces_per_s), data)
    {:ok, stream} = if messages == [], do: {:ok, stream}, else: Writer.append(stream, messages)
    :counters.put(made, 1, max(due, n))
    Process.sleep(20)
    record(stream, made, started, max(due, n))
  end

  defp message(i, every, data) do
    %Message{data: data, originating_time: i * every, creation_time: i * every, sequence_id: i}
  end

  defp recorder do
    root = Situ.Bench.folder!()
    {:ok, _} = Application.ensure_all_started(:situ_link)
    {:ok, writer} = Writer.create("catch-up", root)
    {root, writer}
  end

  defp address(server), do: "situ://127.0.0.1:#{Server.port(server)}"
end
