defmodule Situ.Infer.Task.Transcript do
  @moduledoc false
  # The batch task `transcript`. It transcribes an audio stream into a new partition of each
  # session.
  #
  # It needs the speech model, which `bin/lib/fetch-model moonshine-tiny-en` downloads.

  @doc "Returns the task's description."
  @spec task() :: map()
  def task do
    %{
      name: "transcript",
      about:
        "transcribe the speech of an audio stream (English): texts with their times in a new partition",
      output: "Transcript",
      options: [
        stream: [type: :string, default: "Audio", doc: "The audio stream."],
        name: [type: :string, default: "Transcript", doc: "The new stream."]
      ]
    }
  end

  @doc "Builds the pipeline of one session: a stream of `Situ.Infer.Speech.Utterance`."
  @spec build(Situ.Graph.Handle.t(), keyword()) :: term()
  def build(_p, opts) do
    opts[:stream]
    |> opts[:open].()
    |> Situ.AudioStream.to_mono()
    |> Situ.AudioStream.resample(16_000)
    |> Situ.Infer.transcribe()
    |> opts[:write].(opts[:name])
  end
end
