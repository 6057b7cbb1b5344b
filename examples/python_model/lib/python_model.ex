defmodule PythonModel do
  @moduledoc """
  Records a camera only while something moves. A model in Python (`priv/motion.py`) learns the appearance of the room
  and reports the pixels that changed; Situ decides when to record.
  """
  use Situ.Pipeline,
    options: [
      input: [
        type: {:optional, :string},
        default: nil,
        doc: "A camera such as /dev/video0, or a video. By default, Situ's demo clip."
      ],
      share: [
        type: :number,
        default: 0.002,
        doc: "The share of moving pixels that counts, 0 to 1."
      ],
      hold: [
        type: :time_ns,
        default: Situ.Time.s(1),
        doc: "How long to record after the last motion."
      ],
      python: [
        type: :string,
        default: "python3",
        doc: "Python with numpy, or a virtual environment."
      ]
    ]

  # The model needs neither colour nor detail, so it gets a smaller image in grey.
  @reduction 4

  alias PythonModel.Gate
  alias Situ.{ImageOps, ImageStream, Media, Reproducible}

  @impl true
  def build(p, opts) do
    clip = opts[:input] || Application.app_dir(:situ_examples, "priv/demo/talk3.mp4")
    camera = Media.open(p, clip).video

    motion =
      camera
      |> ImageStream.scale(1 / @reduction, 1 / @reduction)
      |> ImageStream.convert(:gray8)
      |> Situ.Python.component(Application.app_dir(:python_model, "priv/motion.py:Motion"),
        python: opts[:python],
        options: [memory: 25, tolerance: 4.0],
        out: [share: :float, where: {:list, Situ.Rect}]
      )

    share = Situ.name(motion.share, "Motion")
    Situ.map(motion.where, &enlarge/1, type: {:list, Situ.Rect}, name: "Where")
    recording = Situ.via(share, Gate, above: opts[:share], hold: opts[:hold], name: "Recording")

    camera
    |> Situ.join(recording, Reproducible.exact())
    |> Situ.filter(fn {_image, recording?} -> recording? end)
    |> Situ.map(fn {image, _} -> encode(image) end, type: Situ.EncodedImage, name: "Camera")
  end

  # Converts pixels of the smaller image to pixels of the camera.
  defp enlarge(rects) do
    for %{x: x, y: y, width: w, height: h} <- rects,
        do: Situ.Rect.new!(@reduction * x, @reduction * y, @reduction * w, @reduction * h)
  end

  defp encode(image), do: image |> ImageOps.encode_jpeg(quality: 80) |> Situ.Error.unwrap!()
end
