defmodule Situ.Infer.Task.Transcript do
  @moduledoc """
  The batch task `transcript`: the words of a sound stream, as a new partition of each session.

  The speech model has to be there: `bin/lib/fetch-model moonshine-tiny-en` fetches it.
  """

  @doc "The task's description."
  @spec task() :: map()
  def task do
    %{
      name: "transcript",
      about:
        "transcribe the speech of a sound stream (English): texts with their times in a new partition",
      output: "Transcript",
      options: [
        stream: [type: :string, default: "Audio", doc: "The sound."],
        name: [type: :string, default: "Transcript", doc: "The new stream."]
      ]
    }
  end

  @doc "Builds the pipeline of one session: a stream of `Situ.Infer.Speech.Utterance`."
  @spec build(Situ.Graph.Handle.t(), keyword()) :: term()
  def build(_p, opts) do
    opts[:stream]
    |> opts[:open].()
    |> Situ.Audio.to_mono()
    |> Situ.Audio.resample(16_000)
    |> Situ.Infer.transcribe()
    |> opts[:write].(opts[:name])
  end
end
