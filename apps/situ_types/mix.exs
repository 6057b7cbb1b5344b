defmodule Situ.Types.MixProject do
  use Mix.Project

  def project do
    [
      app: :situ_types,
      version: "0.1.0",
      build_path: "../../_build",
      config_path: "../../config/config.exs",
      deps_path: "../../deps",
      lockfile: "../../mix.lock",
      elixir: "~> 1.14",
      start_permanent: Mix.env() == :prod,
      deps: deps()
    ] ++ not_ours([:proper, :proper_types])
  end

  # `Situ.Test.Property` calls PropEr, which is only available in tests. Elixir 1.19 renamed the option.
  defp not_ours(modules) do
    if Version.match?(System.version(), ">= 1.19.0"),
      do: [elixirc_options: [no_warn_undefined: modules]],
      else: [xref: [exclude: modules]]
  end

  def application do
    [extra_applications: extra_applications(Mix.env())]
  end

  defp extra_applications(:test), do: [:proper | extra_applications(:prod)]
  defp extra_applications(_env), do: [:logger, :crypto | json()]

  # OTP 27 and later include a JSON module.
  defp json, do: if(Code.ensure_loaded?(:json), do: [], else: [:jiffy])

  defp deps do
    []
  end
end
