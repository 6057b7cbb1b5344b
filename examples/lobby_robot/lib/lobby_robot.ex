defmodule LobbyRobot do
  @moduledoc """
  A robot in a lobby: greets everybody who looks at it, once per visit.
  """
  use Situ.Pipeline,
    options: [
      input: [
        type: {:optional, :string},
        default: nil,
        doc: "A camera such as /dev/video0, or a video. By default, Situ's demo clip."
      ],
      patience: [
        type: :time_ns,
        default: Situ.Time.ms(800),
        doc: "How long a person looks at the robot before it speaks."
      ],
      absence: [
        type: :time_ns,
        default: Situ.Time.s(30),
        doc: "How long a person is away before it is a new visit."
      ],
      speaker: [type: :boolean, default: false, doc: "Whether to play the robot's voice."]
    ]

  alias LobbyRobot.{Gaze, Greeter}
  alias Situ.{Delivery, ImageOps, Media, Time}
  alias Situ.Infer.{MouthShape, SpeechSynthesizer}

  @impl true
  def build(p, opts) do
    clip = opts[:input] || Application.app_dir(:situ_examples, "priv/demo/talk1.mp4")
    camera = Media.open(p, clip).video

    Situ.map(camera, &encode/1, type: Situ.EncodedImage, name: "Camera")
    faces = MouthShape.detect_stages(camera, policy: policy(clip))
    Situ.map(faces.faces, &rectangles/1, type: {:list, Situ.Rect}, name: "Faces")
    looking = Situ.map(faces.meshes, &Gaze.looks/1, type: {:map, :any, :boolean}, name: "Looking")

    greeting =
      Situ.via(looking, Greeter,
        patience: opts[:patience],
        absence: opts[:absence],
        name: "Greeting"
      )

    Situ.each(greeting, &IO.puts("#{Time.to_iso8601(&2.originating_time)}  #{&1}"))
    voice = greeting |> Situ.via(SpeechSynthesizer) |> Map.fetch!(:out) |> Situ.name("Voice")
    if opts[:speaker], do: Media.Speaker.play(voice)
  end

  # A camera does not wait, so a slow machine skips images. A file is processed completely.
  defp policy("/dev/" <> _), do: Delivery.latest()
  defp policy(_file), do: Delivery.unlimited()

  defp encode(image), do: image |> ImageOps.encode_jpeg(quality: 80) |> Situ.Error.unwrap!()
  defp rectangles(faces), do: for(face <- faces, do: face.rect)
end
