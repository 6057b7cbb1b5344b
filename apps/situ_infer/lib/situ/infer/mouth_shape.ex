defmodule Situ.Infer.MouthShape do
  @schema [
    detector: [type: :keyword, default: [], doc: "Options of `Situ.Infer.FaceDetector`."],
    tracker: [type: :keyword, default: [], doc: "Options of `Situ.Infer.FaceTracker`."],
    landmarks: [type: :keyword, default: [], doc: "Options of `Situ.Infer.FaceLandmarks`."],
    policy: [
      type: {:optional, {:struct, Situ.Delivery}},
      default: nil,
      doc:
        "Of the pictures that come in; live, `Situ.Delivery.latest()` keeps up with a fast camera."
    ]
  ]

  @moduledoc """
  The mouths in a stream of pictures: a composite of face detector, tracker, landmarks and measure.

      pictures -> FaceDetector -> FaceTracker -> FaceLandmarks -> MouthMeasure -> %{id => Situ.Infer.Mouth}
          \\______________________________________/

      mouths = camera |> Situ.Infer.MouthShape.detect()

  `detect/2` gives the stream of mouths, `parts/2` the streams between the parts too. Each part is a process, so
  detector and landmarks work on different pictures at the same time.

  ## Options

  #{Situ.Options.docs(@schema)}
  """
  alias Situ.Infer.{FaceDetector, FaceLandmarks, FaceTracker, MouthMeasure}
  alias Situ.Stream

  @type parts :: %{faces: Stream.t(), meshes: Stream.t(), mouths: Stream.t()}

  @doc "The stream of `%{face id => Situ.Infer.Mouth}`, one for every picture."
  @spec detect(Stream.t(), keyword()) :: Stream.t()
  def detect(pictures, opts \\ []), do: parts(pictures, opts).mouths

  @doc "Streams of tracked faces, meshes and mouths."
  @spec parts(Stream.t(), keyword()) :: parts()
  def parts(%Stream{} = pictures, opts \\ []) do
    opts = Situ.Options.validate!(opts, @schema)

    Situ.composite(pictures, "MouthShape", fn pictures ->
      faces =
        pictures
        |> Situ.via(FaceDetector, [policy: opts[:policy]] ++ opts[:detector])
        |> Situ.via(FaceTracker, opts[:tracker])

      # Exact: a picture that the detector dropped has no faces and goes no further.
      meshes =
        pictures
        |> Situ.join(faces)
        |> Situ.via(FaceLandmarks, [policy: opts[:policy]] ++ opts[:landmarks])

      mouths = Situ.via(meshes, MouthMeasure)
      %{faces: faces, meshes: meshes, mouths: mouths}
    end)
  end
end
