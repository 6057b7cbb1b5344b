defmodule Situ.Infer.Task.Pictures do
  @moduledoc false
  # Streams of pictures as tasks meet them: raw, or JPEG and the like, and then decoded.

  @spec decoded(Situ.Stream.t(), String.t(), [{String.t(), map()}]) :: Situ.Stream.t()
  def decoded(stream, name, streams) do
    encoded? =
      Enum.any?(streams, fn {partition, info} ->
        name in [info.name, "[#{partition}]:#{info.name}"] and info.type == Situ.EncodedImage
      end)

    if encoded?, do: Situ.Vision.decode(stream), else: stream
  end
end
