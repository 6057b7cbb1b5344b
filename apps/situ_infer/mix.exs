Code.require_file("../../config/mix_app.exs", __DIR__)

defmodule Situ.Infer.MixProject do
  use Mix.Project

  def project do
    Situ.MixApp.project(:situ_infer,
      native: [crates: ~w(situ_infer_nif), programs: ~w(situ_speak)],
      deps: [:situ_types, :situ, :situ_media]
    )
  end

  def application do
    Situ.MixApp.application([:ssl, :public_key],
      mod: {Situ.Infer.Application, []},
      env: [
        dataset_tasks: [
          Situ.Infer.Task.Anonymise,
          Situ.Infer.Task.Faces,
          Situ.Infer.Task.Transcript,
          Situ.Infer.Task.VoiceActivity
        ]
      ]
    )
  end
end
