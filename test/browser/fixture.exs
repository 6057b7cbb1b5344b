defmodule Fixture do
  @moduledoc false
  # The data for the browser tests: a minute of every kind of data, the same each time, so that
  # tests can check exact pixels.
  alias Situ.Store.Writer
  alias Situ.Studio.History

  @t0 1_767_225_600_000_000_000

  def t0, do: @t0

  # The color of the image and the values of the signals are functions of the second s.
  def color(s), do: {rem(s * 4, 256), 255 - rem(s * 4, 256), rem(s * 40, 256)}

  @types %{
    "Imu.Acc.X" => :float,
    "Imu.Acc.Y" => :float,
    "Mic.Level" => :float,
    "Mic.Audio" => Situ.AudioBuffer,
    "Camera.Image" => Situ.Image,
    "Camera.Faces" => {:list, Situ.Rect},
    "Kinect.Depth" => Situ.DepthImage,
    "Vad.Speaking" => :boolean,
    "Robot.State" => {:in, [:idle, :moving, :turning]},
    "Speech.Text" => :string,
    "Speech.Scores" => {:map, :string, :float},
    "Speech.Who" => {:map, :string, :boolean},
    "Speech.Parts" => Situ.Interval
  }

  # The minute in memory, and as a recording on disk.
  def minute do
    h = History.new(seconds: 3_600, megabytes: 400, live: false)
    for {name, time, latency, data, n} <- messages(), do: put(h, name, time, latency, data, n)
    h
  end

  def record(name, folder) do
    {:ok, writer} = Writer.create(name, folder)
    groups = Enum.group_by(messages(), &elem(&1, 0))

    for {stream, rows} <- groups do
      {:ok, out} = Writer.stream(writer, stream, type: Map.get(@types, stream, :any))
      {:ok, out} = Writer.append(out, Enum.map(rows, &message/1))
      {:ok, _} = Writer.close_stream(out, @t0 + 60_000_000_000)
    end

    :ok = Writer.close(writer)
  end

  # Two hundred streams with a few messages.
  def record_many(name, folder) do
    {:ok, writer} = Writer.create(name, folder)

    for robot <- 1..10, joint <- 1..20 do
      {:ok, out} = Writer.stream(writer, "Robot#{robot}.Joint#{joint}.Angle", type: :float)

      rows =
        for i <- 0..29, do: message({"", @t0 + i * 1_000_000_000, 0, :math.sin(i + joint), i})

      {:ok, out} = Writer.append(out, rows)
      {:ok, _} = Writer.close_stream(out, @t0 + 30_000_000_000)
    end

    :ok = Writer.close(writer)
  end

  # A minute in which one stream begins late and another ends early.
  def record_uneven(name, folder) do
    {:ok, writer} = Writer.create(name, folder)

    for {stream, type, seconds} <- [
          {"Whole", :float, 0..600},
          {"Late", :float, 200..600},
          {"Short", :boolean, 0..300}
        ] do
      {:ok, out} = Writer.stream(writer, stream, type: type)

      messages =
        for i <- seconds do
          data = if type == :float, do: :math.sin(i / 40), else: rem(div(i, 50), 2) == 0
          message({stream, @t0 + i * 100_000_000, 0, data, i})
        end

      {:ok, out} = Writer.append(out, messages)
      {:ok, _} = Writer.close_stream(out, @t0 + 60_000_000_000)
    end

    :ok = Writer.close(writer)
  end

  # Ten seconds of video with the color `color/1` of each second, and with a tone that begins at
  # second 5.
  def film(folder) do
    picture =
      "nullsrc=s=320x180:r=25:d=10,geq=r='mod(floor(T)*4,256)':g='255-mod(floor(T)*4,256)':b='mod(floor(T)*40,256)'"

    tone = "aevalsrc='if(gte(t,5),0.8*sin(2*PI*440*t),0)':s=16000:d=10"

    {_, 0} =
      System.cmd(
        "ffmpeg",
        ~w(-v error -nostdin -y -f lavfi -i #{picture},format=yuv444p -f lavfi -i) ++
          [tone] ++
          ~w(-c:v libx264 -preset veryfast -g 50 -c:a aac) ++ [Path.join(folder, "film.mp4")]
      )
  end

  # A signal of n points at 1 kHz, with one spike that no summary may lose.
  def record_big(name, folder, n) do
    {:ok, writer} = Writer.create(name, folder)
    {:ok, out} = Writer.stream(writer, "Signal", type: :float)

    out =
      0..(n - 1)
      |> Stream.chunk_every(20_000)
      |> Enum.reduce(out, fn part, out ->
        messages =
          for i <- part do
            value = if i == div(n, 3), do: 25.0, else: :math.sin(i / 50_000) + :rand.uniform() / 4
            t = @t0 + i * 1_000_000
            %Situ.Message{data: value, originating_time: t, creation_time: t, sequence_id: i}
          end

        {:ok, out} = Writer.append(out, messages)
        out
      end)

    {:ok, _} = Writer.close_stream(out, @t0 + n * 1_000_000)
    :ok = Writer.close(writer)
  end

  # Records a signal at 1 kHz with single outliers, and writes its values to `values_file`.
  def record_dense(name, folder, values_file) do
    :rand.seed(:exsss, {4, 2, 29})

    values =
      for i <- 0..39_999 do
        spike = if :rand.uniform(2_000) == 1, do: 40 * (:rand.uniform() - 0.5), else: 0
        Float.round(:math.sin(i / 2_000) * 5 + :rand.uniform() / 2 + spike, 6)
      end

    {:ok, writer} = Writer.create(name, folder)
    {:ok, out} = Writer.stream(writer, "Signal", type: :float)

    messages =
      for {v, i} <- Enum.with_index(values), do: message({"", @t0 + i * 1_000_000, 0, v, i})

    {:ok, out} = Writer.append(out, messages)
    {:ok, _} = Writer.close_stream(out, @t0 + 39_999 * 1_000_000)
    :ok = Writer.close(writer)
    File.write!(values_file, Situ.JSON.encode(values))
  end

  # Random streams: regular streams with gaps, irregular streams, states that change quickly or
  # rarely, and maps of them. A file next to the recording contains the data for comparison.
  def record_zoo(name, folder, told) do
    :rand.seed(:exsss, {1, 7, 1})
    ms = 1_000_000

    streams = [
      {"Zoo.Regular", :float,
       for(i <- steps(6_000, [10]), do: {i, Float.round(:math.sin(i / 900) * 10, 3)})},
      {"Zoo.Irregular", :float,
       for(i <- steps(400, 20..400), do: {i, Float.round(:rand.uniform() * 5, 3)})},
      {"Zoo.Runs", :boolean, runs(steps(30_000, [2]), 2_000)},
      {"Zoo.Flicker", :boolean, runs(steps(20_000, [3]), 2)},
      {"Zoo.State", {:in, [:idle, :moving, :turning]}, states(steps(500, 60..180))},
      {"Zoo.Map", {:map, :string, :boolean},
       for(
         {i, v} <- runs(steps(3_000, [20]), 400),
         do: {i, %{"a" => v, "b" => rem(i, 7_000) < 3_500}}
       )}
    ]

    {:ok, writer} = Writer.create(name, folder)

    for {stream, type, rows} <- streams do
      {:ok, out} = Writer.stream(writer, stream, type: type)

      messages =
        for {{i, data}, n} <- Enum.with_index(rows),
            do: message({stream, @t0 + i * ms, 0, data, n})

      {:ok, out} = Writer.append(out, messages)
      {:ok, _} = Writer.close_stream(out, @t0 + 60_000 * ms)
    end

    :ok = Writer.close(writer)

    truth =
      for {stream, _, rows} <- streams, into: %{}, do: {stream, Enum.map(rows, &Tuple.to_list/1)}

    File.write!(told, Situ.JSON.encode(truth))
  end

  # Times in milliseconds with this step within a minute, with three gaps of some seconds.
  defp steps(n, pauses) do
    holes = for _ <- 1..3, at = :rand.uniform(55_000), do: at..(at + 500 + :rand.uniform(4_000))

    0
    |> Stream.iterate(&(&1 + Enum.random(pauses)))
    |> Stream.take_while(&(&1 < 60_000))
    |> Stream.reject(fn i -> Enum.any?(holes, &(i in &1)) end)
    |> Enum.take(n)
  end

  # Values that stay the same for 1 to `most` messages.
  defp runs(steps, most) do
    {rows, _} =
      Enum.map_reduce(steps, {true, 1}, fn
        i, {value, 1} -> {{i, value}, {not value, round(:math.pow(most, :rand.uniform()))}}
        i, {value, left} -> {{i, not value}, {value, left - 1}}
      end)

    rows
  end

  defp states(steps),
    do: for(i <- steps, do: {i, Enum.at([:idle, :moving, :turning], div(i, 2_300) |> rem(3))})

  # Writes 30 images and the values of ten signals per second until the process ends.
  def record_live(name, folder) do
    {:ok, writer} = Writer.create(name, folder)

    outs =
      for {stream, type} <- [
            {"Live.Image", Situ.Image} | for(i <- 0..9, do: {"Live.S#{i}", :float})
          ] do
        {:ok, out} = Writer.stream(writer, stream, type: type)
        {stream, out}
      end

    start = System.os_time() - 40_000_000_000
    outs = Enum.reduce(0..1_199, outs, &live(&2, &1, start + &1 * 33_333_333))
    tick(outs, 1_200)
  end

  defp tick(outs, i) do
    outs = live(outs, i, System.os_time())
    Process.sleep(33)
    tick(outs, i + 1)
  end

  defp live(outs, i, t) do
    for {stream, out} <- outs do
      data =
        case stream do
          "Live.Image" -> picture(rem(i, 60))
          "Live.S" <> k -> :math.sin(i / 30 + String.to_integer(k))
        end

      {:ok, out} = Writer.append(out, [message({stream, t, 1_000_000, data, i})])
      {stream, out}
    end
  end

  defp message({_, time, latency, data, n}) do
    %Situ.Message{
      data: data,
      originating_time: time,
      creation_time: time + latency,
      sequence_id: n
    }
  end

  def put(h, name, time, latency, data, n) do
    message = %Situ.Message{
      data: data,
      originating_time: time,
      creation_time: time + latency,
      sequence_id: n
    }

    History.put(h, name, message, History.estimate_size(data))
  end

  # {stream, originating time, latency, data, sequence}
  def messages do
    ms = 1_000_000

    signals =
      for i <- 0..5_999, t = @t0 + i * 10 * ms, {name, value, latency} <- signal(i / 100) do
        {name, t, latency * ms, value, i}
      end

    seconds =
      for s <- 0..59, t = @t0 + s * 1_000 * ms, {name, value} <- second(s) do
        {name, t, 3 * ms, value, s}
      end

    sound =
      for b <- 0..599 do
        {"Mic.Audio", @t0 + (b + 1) * 100 * ms, ms, buffer(b), b}
      end

    signals ++ seconds ++ sound
  end

  defp signal(s) do
    [
      {"Imu.Acc.X", 9.8 * :math.sin(s / 3), 1},
      {"Imu.Acc.Y", 4.0 * :math.cos(s / 2), if(s > 30 and s < 31, do: 80, else: 2)},
      {"Mic.Level", abs(:math.sin(s)), 1}
    ]
  end

  defp second(s) do
    [
      {"Camera.Image", picture(s)},
      {"Camera.Faces",
       [%Situ.Rect{x: 10, y: 10, width: 20, height: 20, label: "Ada", score: 0.93, id: 0}]},
      {"Kinect.Depth", depth(s)},
      {"Vad.Speaking", rem(div(s, 5), 2) == 1},
      {"Robot.State", Enum.at([:idle, :moving, :turning], rem(div(s, 4), 3))},
      {"Speech.Text", "word #{s}"},
      {"Speech.Who", who(s)},
      {"Speech.Parts", part(s)},
      {"Speech.Scores", %{"go" => s / 60, "stop" => 1 - s / 60}},
      {"<script>hacked=1</script>",
       %{pose: %{x: s * 1.5, name: "<img src=x onerror=window.hacked=1>"}, tags: ["<b>a</b>"]}}
    ]
  end

  # Ada speaks in every other interval of ten seconds. Bob is present from 20 s to 40 s and never
  # speaks.
  defp who(s) when s in 20..39, do: %{"Ada" => rem(div(s, 10), 2) == 0, "Bob" => false}
  defp who(s), do: %{"Ada" => rem(div(s, 10), 2) == 0}

  # Every second has an interval in its first 600 ms.
  defp part(s) do
    t = @t0 + s * 1_000_000_000
    Situ.Interval.closed(t, t + 600_000_000)
  end

  def picture(s) do
    {r, g, b} = color(s)
    Situ.Image.new_filled(64, 48, :rgb24, [r, g, b])
  end

  defp depth(s) do
    data = for y <- 0..29, x <- 0..39, into: <<>>, do: <<500 + s * 10 + x * 20 + y::little-16>>
    Situ.DepthImage.new!(width: 40, height: 30, data: data)
  end

  # 440 Hz, silent in every other second
  defp buffer(b) do
    loud = rem(div(b, 10), 2) == 0

    data =
      for i <- 0..1_599, into: <<>> do
        x =
          if loud,
            do: round(12_000 * :math.sin(2 * :math.pi() * 440 * (b * 1_600 + i) / 16_000)),
            else: 0

        <<x::little-signed-16>>
      end

    %Situ.AudioBuffer{
      format: %Situ.AudioFormat{rate: 16_000, channels: 1, sample: :s16},
      data: data
    }
  end
end

defmodule Fixture.Loudness do
  @moduledoc false
  # A batch task with an option of each kind. With `hold`, it waits while a file exists.
  @behaviour Situ.Dataset.Task

  @impl true
  def task do
    %{
      name: "loudness",
      about: "how loud a stream of numbers is",
      output: "Loudness",
      options: [
        stream: [type: :string, default: "Mic.Level", doc: "The numbers."],
        gain: [type: {:range, 0, 10}, default: 2, doc: "The factor."],
        scale: [type: {:in, [:linear, :decibel]}, default: :linear, doc: "How it is told."],
        hold: [
          type: :boolean,
          default: false,
          doc: "Wait as long as a file called hold is there."
        ]
      ]
    }
  end

  @impl true
  def build(_p, opts) do
    gate = Path.join(opts[:folder], "hold")

    opts[:stream]
    |> opts[:open].()
    |> Situ.map(fn x ->
      wait(opts[:hold] and File.exists?(gate), gate)
      x * opts[:gain]
    end)
    |> opts[:write].("Loudness")
  end

  defp wait(false, _gate), do: :ok

  defp wait(true, gate) do
    Process.sleep(20)
    wait(File.exists?(gate), gate)
  end
end
