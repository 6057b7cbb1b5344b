defmodule Situ.Media.Task.EncodeImages do
  @moduledoc false
  # The batch task `encode-pictures`. It copies a stream of raw images as JPEG into a new
  # partition of each session.

  @doc "Returns the description of the task."
  @spec task() :: map()
  def task do
    %{
      name: "encode-pictures",
      about: "copy a stream of raw images as JPEG into a new partition",
      output: "Pictures",
      options: [
        stream: [type: :string, default: "Video", doc: "The image stream."],
        quality: [type: {:integer, 1, 100}, default: 90, doc: "JPEG quality."]
      ]
    }
  end

  @doc "Builds the pipeline for one session."
  @spec build(Situ.Graph.Handle.t(), keyword()) :: term()
  def build(_p, opts) do
    jpeg = fn picture ->
      picture |> Situ.ImageOps.encode_jpeg(quality: opts[:quality]) |> Situ.Error.unwrap!()
    end

    opts[:stream]
    |> opts[:open].()
    |> Situ.map(jpeg, type: Situ.EncodedImage)
    |> opts[:write].(opts[:stream])
  end
end
