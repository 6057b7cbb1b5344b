defmodule Situ.Media.Task.EncodePictures do
  @moduledoc "The batch task `encode-pictures`: a stream of raw pictures as JPEG, in a new partition of each session."

  @doc "The task's description."
  @spec task() :: map()
  def task do
    %{
      name: "encode-pictures",
      about: "copy a stream of raw pictures as JPEG into a new partition",
      output: "Pictures",
      options: [
        stream: [type: :string, default: "Video", doc: "The pictures."],
        quality: [type: {:integer, 1, 100}, default: 90, doc: "Of the JPEG."]
      ]
    }
  end

  @doc "Builds the pipeline of one session."
  @spec build(Situ.Graph.Handle.t(), keyword()) :: term()
  def build(_p, opts) do
    jpeg = fn picture ->
      picture |> Situ.Imaging.encode_jpeg(quality: opts[:quality]) |> Situ.Error.unwrap!()
    end

    opts[:stream]
    |> opts[:open].()
    |> Situ.map(jpeg, type: Situ.EncodedImage)
    |> opts[:write].(opts[:stream])
  end
end
