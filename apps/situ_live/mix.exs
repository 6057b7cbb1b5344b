defmodule Situ.Live.MixProject do
  use Mix.Project

  def project do
    find_yaws()

    [
      app: :situ_live,
      version: "0.1.0",
      build_path: "../../_build",
      config_path: "../../config/config.exs",
      deps_path: "../../deps",
      lockfile: "../../mix.lock",
      elixir: "~> 1.14",
      elixirc_paths: elixirc_paths(Mix.env()),
      start_permanent: Mix.env() == :prod,
      # Newer versions of Elixir remove code paths that no dependency names. Yaws is found through such a path.
      prune_code_paths: false,
      deps: deps()
    ]
  end

  # Yaws is an included application, because as a separate application it requires a system-wide configuration.
  # `Situ.Live.Yaws` starts it embedded.
  def application do
    [
      mod: {Situ.Live.Application, []},
      extra_applications: extra_applications(Mix.env()),
      included_applications: [:yaws]
    ]
  end

  defp elixirc_paths(:test), do: ["lib", "test/support"]
  defp elixirc_paths(_env), do: ["lib"]

  defp extra_applications(:test), do: [:proper | extra_applications(:prod)]
  defp extra_applications(_env), do: [:logger, :crypto, :public_key, :ssl]

  defp deps do
    [{:situ_types, in_umbrella: true}]
  end

  # Debian installs Yaws next to Erlang's own tree (LIB/yaws-VERSION, Erlang in LIB/erlang/lib), where the code server
  # does not look. It is found through a link below _build, because a release takes the folder that contains an
  # application as the root of all of them, and LIB also contains Erlang.
  defp find_yaws do
    erlang = to_string(:code.lib_dir())

    with dir when dir != nil <- yaws_dir(erlang), false <- linked?(dir, erlang) do
      Code.delete_path(Path.join(dir, "ebin"))
      Code.append_path(Path.join(link(dir), "ebin"))
    end
  end

  defp linked?(dir, erlang), do: not String.starts_with?(erlang, Path.dirname(dir) <> "/")

  defp yaws_dir(erlang) do
    case :code.lib_dir(:yaws) do
      {:error, :bad_name} ->
        [erlang, Path.dirname(erlang), erlang |> Path.dirname() |> Path.dirname()]
        |> Enum.flat_map(&Path.wildcard(Path.join(&1, "yaws-*")))
        |> Enum.filter(&File.exists?(Path.join(&1, "ebin/yaws_server.beam")))
        |> Enum.max(fn -> nil end)

      dir ->
        to_string(dir)
    end
  end

  defp link(dir) do
    link = Path.expand("../../_build/linked/#{Path.basename(dir)}", __DIR__)
    File.mkdir_p(Path.dirname(link))
    File.ln_s(dir, link)
    if File.exists?(Path.join(link, "ebin")), do: link, else: dir
  end
end
