defmodule Situ.Examples.Scene do
  @moduledoc """
  Records a room with two people, seen by a depth camera and heard by a microphone, and everything detected in it.

      {:ok, report} = Situ.Pipeline.run(Situ.Examples.Scene, path: "recordings", seconds: 12)

  The room is `Situ.Space.SyntheticRoom`, so the example runs anywhere. Any other `Situ.Space.DepthCamera` with bodies
  can replace it (`camera: {module, options}`). The audio comes from the demo clip, and the people in the room speak at
  the same times as the people in the clip. The recording, `path/Scene.NNNN`, contains

    * `Room.Cloud`: colored points in the room's coordinate frame, `Room.Bodies`, `Room.Pointing`, `Room.Ball`,
      `Room.Camera`
    * `Room.Person` and `Room.Detections`: the image cropped to the walking person, and the detections in it
    * `Room.Sound`, `Room.Energy`, `Room.Voice`, `Room.Speech`: the waveform, its log energy, the probability of voice,
      and the intervals with speech, with the speaker
    * `Room.Heights` and `Room.Latencies`: histograms of the points' heights and of the point clouds' latencies
  """
  use Situ.Pipeline

  alias Situ.{CameraView, EncodedImage, PointCloud}
  alias Situ.Examples.Scene.{Crop, Histogram}
  alias Situ.Infer.VoiceActivity
  alias Situ.Space.{DepthCamera, SyntheticRoom}

  # `{person, from, to}` in seconds: the speech of the clip, assigned to the people in the room.
  @speech [{0, 0.76, 3.6}, {1, 5.0, 6.92}, {0, 7.96, 9.52}, {1, 10.48, 11.44}]
  @size [width: 320, height: 240, rate: 15]

  @impl true
  def build(p, opts) do
    camera = DepthCamera.open(p, opts[:camera] || {SyntheticRoom, room_options(opts)})
    store = Situ.Store.create(p, "Scene", opts[:path])
    record = &Situ.Store.write(&1, store, "Room." <> &2)

    clouds = color_clouds(camera)
    record.(clouds, "Cloud")
    record.(Situ.map(camera.depth, &{&1.intrinsics, &1.pose}, name: "Camera"), "Camera")

    for {name, stream} <- [{"Bodies", :bodies}, {"Pointing", :pointing}, {"Ball", :ball}],
        do: record.(camera.others[stream], name)

    persons = crop_persons(camera)
    record.(Situ.map(persons, &elem(&1, 0), name: "Person", type: EncodedImage), "Person")

    record.(
      Situ.map(persons, &elem(&1, 1), name: "Detections", type: {:list, :any}),
      "Detections"
    )

    record_audio(p, camera, opts, record)

    record.(
      Situ.map(clouds, &Histogram.height_rows/1, name: "Heights", type: {:list, :any}),
      "Heights"
    )

    record.(latency_histogram(clouds), "Latencies")
    record.(Situ.Diagnostics.stream(p), "Diagnostics")
    store
  end

  defp room_options(opts), do: [seconds: opts[:seconds] || 12, speech: @speech] ++ @size

  # Colors the points with the image taken at the same time.
  defp color_clouds(camera) do
    camera.depth
    |> Situ.join(camera.color, Situ.Reproducible.exact())
    |> Situ.map(
      fn {depth, color} ->
        depth |> DepthCamera.view_to_cloud(colors: color.viewed) |> Situ.Error.unwrap!()
      end,
      name: "Cloud",
      type: PointCloud
    )
  end

  # Crops the image to the walking person, and returns it with the detections in it.
  defp crop_persons(camera) do
    camera.color
    |> Situ.join(camera.others.bodies, Situ.Reproducible.exact())
    |> Situ.map(
      fn {%CameraView{} = view, bodies} ->
        found = Enum.map(bodies, &Crop.body_detection(view, &1))
        {picture, offset} = Crop.crop_around(view.viewed, hd(found))

        {encode_jpeg(picture),
         found |> Enum.map(&Crop.shift_detection(&1, offset)) |> Crop.filter_inside(picture)}
      end,
      name: "Persons"
    )
  end

  defp encode_jpeg(picture),
    do: picture |> Situ.ImageOps.encode_jpeg(quality: 85) |> Situ.Error.unwrap!()

  defp record_audio(p, camera, opts, record) do
    clip = opts[:sound] || Situ.Examples.Demo.Options.default_clip()
    format = Situ.AudioFormat.pcm(16_000)
    sound = Situ.Media.open(p, clip, audio_format: format, start_time: :pipeline).audio
    heard = Situ.via(sound, VoiceActivity, name: "VoiceActivity")
    record.(sound, "Sound")
    record.(Situ.AudioStream.features(sound, name: "Features").log_energy, "Energy")
    record.(Situ.map(heard.voice, & &1.probability, name: "Probability", type: :float), "Voice")
    record.(speech_intervals(heard.segments, camera.others[:speaking]), "Speech")
  end

  # Emits the intervals with speech, with the speaker if the room reports who is speaking.
  defp speech_intervals(segments, nil),
    do: Situ.map(segments, &to_interval/1, name: "Speech", type: Situ.Interval)

  defp speech_intervals(segments, speaking) do
    last = Situ.scan(speaking, nil, &last_speaker/3, name: "Last speaker")

    segments
    |> Situ.join(last, Situ.Reproducible.nearest(Situ.Time.ms(100)))
    |> Situ.map(fn {segment, who} -> {to_interval(segment), "person #{who}"} end, name: "Speech")
  end

  defp last_speaker(now, _message, last),
    do: Enum.find_value(now, last, fn {who, speaks?} -> if speaks?, do: who end)

  defp to_interval(segment), do: Situ.Interval.closed(segment.start, segment.stop)

  defp latency_histogram(clouds) do
    clouds
    |> Situ.map(fn _cloud, message -> Situ.Message.latency(message) end, name: "Latency")
    |> Situ.scan(Histogram.new(), &Histogram.add_latency(&2, &1), name: "Latencies")
    |> Situ.map(&Histogram.latency_rows/1, name: "LatencyRows", type: {:list, :any})
  end
end
