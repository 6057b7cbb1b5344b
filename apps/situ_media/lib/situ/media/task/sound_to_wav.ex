defmodule Situ.Media.Task.SoundToWav do
  @moduledoc """
  The batch task `sound-to-wav`: a sound stream of each session as a WAV file beside its recordings.

  A task of `situ_dataset`, whose behaviour this follows without naming it: media stand beside datasets, not above.
  """

  @doc "The task's description."
  @spec task() :: map()
  def task do
    %{
      name: "sound-to-wav",
      about: "write a sound stream of each session into a WAV file beside its recordings",
      output: nil,
      options: [
        stream: [type: :string, default: "Audio", doc: "The sound."],
        file: [
          type: :string,
          default: "Audio.wav",
          doc: "The file's name; the session's name comes before it."
        ]
      ]
    }
  end

  @doc "Builds the pipeline of one session."
  @spec build(Situ.Graph.Handle.t(), keyword()) :: term()
  def build(_p, opts) do
    path = Path.join(opts[:folder], "#{opts[:session].name}.#{opts[:file]}")
    opts[:stream] |> opts[:open].() |> Situ.Media.WavWriter.write(path, fill_gaps: true)
  end
end
