defmodule Situ.Infer.MouthShape do
  @moduledoc """
  Measures the mouths in a stream of images with a face detector, a face tracker, face landmarks and a mouth tracker.

      mouths = camera |> Situ.Infer.MouthShape.detect()

      images -> FaceDetector -> FaceTracker -> FaceLandmarks -> MouthTracker -> %{id => mouth}
         \\____________________________________/

  `detect/2` returns the stream of mouths, and `detect_stages/2` also returns the intermediate streams. Each stage is
  a process, so detector and landmarks work on different images at the same time. A mouth is a struct:

  | field | content |
  |---|---|
  | `opening` | the distance between the inner lips divided by the distance between the outer corners of the eyes: about 0.0 to 0.2 when closed, depending on the face, and up to 0.4 wide open |
  | `baseline` | the opening of **this** mouth when it is closed, learned while tracking it |
  | `open?` | whether the mouth is clearly more open than the baseline |
  | `time` | the time of the image |
  | `rect` | the rectangle of the face |

  Only changes within one face are meaningful, because faces differ more than the mouth of one face does.
  """

  @schema [
    detector: [type: :keyword, default: [], doc: "Options for `Situ.Infer.FaceDetector`."],
    tracker: [type: :keyword, default: [], doc: "Options for `Situ.Infer.FaceTracker`."],
    landmarks: [type: :keyword, default: [], doc: "Options for `Situ.Infer.FaceLandmarks`."],
    policy: [
      type: {:optional, {:struct, Situ.Delivery}},
      default: nil,
      doc:
        "The delivery policy for the images; live, `Situ.Delivery.latest()` keeps up with a fast camera."
    ]
  ]

  Situ.Options.add_to_moduledoc(__MODULE__, @schema)

  alias Situ.Infer.{FaceDetector, FaceLandmarks, FaceTracker, MouthTracker}
  alias Situ.Stream

  @type parts :: %{faces: Stream.t(), meshes: Stream.t(), mouths: Stream.t()}

  @doc "Returns a stream of maps from face id to mouth, one for every image."
  @spec detect(Stream.t(), keyword()) :: Stream.t()
  def detect(pictures, opts \\ []), do: detect_stages(pictures, opts).mouths

  @doc "Returns the streams of tracked faces (`Situ.Infer.Face`), meshes (`Situ.Infer.FaceMesh`) and mouths."
  @spec detect_stages(Stream.t(), keyword()) :: parts()
  def detect_stages(%Stream{} = pictures, opts \\ []) do
    opts = Situ.Options.validate!(opts, @schema)

    Situ.composite(pictures, "MouthShape", fn pictures ->
      faces =
        pictures
        |> Situ.via(FaceDetector, [policy: opts[:policy]] ++ opts[:detector])
        |> Situ.via(FaceTracker, opts[:tracker])

      # The join is exact, so images that the detector dropped are dropped here, too.
      meshes =
        pictures
        |> Situ.join(faces)
        |> Situ.via(FaceLandmarks, [policy: opts[:policy]] ++ opts[:landmarks])

      mouths = Situ.via(meshes, MouthTracker)
      %{faces: faces, meshes: meshes, mouths: mouths}
    end)
  end
end
