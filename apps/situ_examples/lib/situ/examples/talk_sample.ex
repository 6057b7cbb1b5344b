defmodule Situ.Examples.TalkSample do
  @moduledoc false
  # The sample recording of the studio: the clip of `bin/demo`, with faces, voice and who is speaking.
  @behaviour Situ.Studio.SampleRecording
  alias Situ.Examples.MultimodalVoiceActivity
  alias Situ.Pipeline

  @impl true
  def describe, do: "Two people talk for 14 seconds: images, audio, faces, and who is speaking."

  @impl true
  def create(folder, report) do
    {:ok, _} = Application.ensure_all_started(:situ_examples)
    clip = Application.app_dir(:situ_examples, "priv/demo/talk1.mp4")

    build = fn p ->
      :ok = Pipeline.on(p, :progress, report)
      MultimodalVoiceActivity.build(p, input: clip, path: folder)
    end

    settings = [name: "Talk", replay: [speed: :max], progress_every: 200]
    with {:ok, run} <- Pipeline.run(build, pipeline: settings), do: {:ok, run.result.path}
  end
end
