Code.require_file("../../config/mix_app.exs", __DIR__)

defmodule Situ.Assistant.MixProject do
  use Mix.Project

  def project do
    Situ.MixApp.project(:situ_assistant,
      deps: [:situ_types, :situ, :situ_store, :situ_media, :situ_infer]
    )
  end

  def application do
    Situ.MixApp.application()
  end
end
