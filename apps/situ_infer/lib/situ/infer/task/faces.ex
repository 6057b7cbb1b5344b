defmodule Situ.Infer.Task.Faces do
  @moduledoc false
  # The batch task `faces`. It finds faces in an image stream and writes them to a new partition
  # per session.

  @doc "Returns the task's description."
  @spec task() :: map()
  def task do
    %{
      name: "faces",
      about: "find and track faces in an image stream: rectangles with ids in a new partition",
      output: "Faces",
      options: [
        stream: [type: :string, default: "Video", doc: "The image stream."],
        name: [type: :string, default: "Faces", doc: "The new stream."],
        min_score: [type: {:range, 0.01, 0.99}, default: 0.5, doc: "The minimum score of a face."]
      ]
    }
  end

  @doc "Builds the pipeline of one session: a stream of lists of `Situ.Infer.Face`."
  @spec build(Situ.Graph.Handle.t(), keyword()) :: term()
  def build(_p, opts) do
    opts[:stream]
    |> opts[:open].()
    |> Situ.Infer.Task.ImageStreams.ensure_decoded(opts[:stream], opts[:streams])
    |> Situ.via(Situ.Infer.FaceDetector, min_score: opts[:min_score])
    |> Situ.via(Situ.Infer.FaceTracker, [])
    |> opts[:write].(opts[:name])
  end
end
