defmodule Situ.Infer.Task.VoiceActivity do
  @moduledoc false
  # The batch task `voice-activity`. It writes whether somebody speaks to a new partition of each
  # session.

  @doc "Returns the task's description."
  @spec task() :: map()
  def task do
    %{
      name: "voice-activity",
      about: "find speech in an audio stream: a stream of booleans in a new partition",
      output: "Voice",
      options: [
        stream: [type: :string, default: "Audio", doc: "The audio stream."],
        name: [type: :string, default: "Speaking", doc: "The new stream."]
      ]
    }
  end

  @doc "Builds the pipeline of one session."
  @spec build(Situ.Graph.Handle.t(), keyword()) :: term()
  def build(_p, opts) do
    opts[:stream]
    |> opts[:open].()
    |> Situ.AudioStream.to_mono()
    |> Situ.AudioStream.resample(16_000)
    |> Situ.Infer.voice_activity()
    |> opts[:write].(opts[:name])
  end
end
