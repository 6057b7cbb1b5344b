defmodule Situ.Media.Task.AudioToWav do
  @moduledoc false
  # The batch task `sound-to-wav`. It writes an audio stream of each session to a WAV file next to
  # its recordings.
  #
  # It implements the task behaviour of `situ_dataset` without naming it, because `situ_media`
  # does not depend on that app.

  @doc "Returns the description of the task."
  @spec task() :: map()
  def task do
    %{
      name: "sound-to-wav",
      about: "write an audio stream of each session to a WAV file next to its recordings",
      output: nil,
      options: [
        stream: [type: :string, default: "Audio", doc: "The audio stream."],
        file: [
          type: :string,
          default: "Audio.wav",
          doc: "Name of the file, appended to the session's name."
        ]
      ]
    }
  end

  @doc "Builds the pipeline for one session."
  @spec build(Situ.Graph.Handle.t(), keyword()) :: term()
  def build(_p, opts) do
    path = Path.join(opts[:folder], "#{opts[:session].name}.#{opts[:file]}")
    opts[:stream] |> opts[:open].() |> Situ.Media.WavWriter.write(path, fill_gaps: true)
  end
end
