Code.require_file("../../config/mix_app.exs", __DIR__)

defmodule Situ.Types.MixProject do
  use Mix.Project

  def project, do: Situ.MixApp.project(:situ_types, deps: [])

  def application do
    Situ.MixApp.application([:crypto, :xmerl | json()])
  end

  # OTP 27 and later include a JSON module.
  defp json, do: if(Code.ensure_loaded?(:json), do: [], else: [:jiffy])
end
