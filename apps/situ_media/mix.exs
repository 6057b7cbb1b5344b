Code.require_file("../../config/mix_app.exs", __DIR__)

defmodule Situ.Media.MixProject do
  use Mix.Project

  def project do
    Situ.MixApp.project(:situ_media,
      native: [crates: ~w(situ_media_nif situ_opencv_nif)],
      deps: [:situ_types, :situ, :situ_store]
    )
  end

  def application do
    Situ.MixApp.application([],
      mod: {Situ.Media.Application, []},
      env: [
        recording_formats: [Situ.Media.Recording, Situ.Media.Wav.Recording],
        video_coder: Situ.Media.StoredVideo,
        dataset_tasks: [Situ.Media.Task.AudioToWav, Situ.Media.Task.EncodeImages]
      ]
    )
  end
end
