defmodule Situ.Infer.Task.ImageStreams do
  @moduledoc false
  # Decodes the image streams of tasks if they contain encoded images such as JPEG.

  @spec ensure_decoded(Situ.Stream.t(), String.t(), [{String.t(), map()}]) :: Situ.Stream.t()
  def ensure_decoded(stream, name, streams) do
    encoded? =
      Enum.any?(streams, fn {partition, info} ->
        name in [info.name, "[#{partition}]:#{info.name}"] and info.type == Situ.EncodedImage
      end)

    if encoded?, do: Situ.ImageStream.decode(stream), else: stream
  end
end
