Code.require_file("../../config/mix_app.exs", __DIR__)

defmodule Situ.Live.MixProject do
  use Mix.Project

  def project do
    find_yaws()

    Situ.MixApp.project(:situ_live,
      # Newer versions of Elixir remove code paths that no dependency names. Yaws is found through such a path.
      prune_code_paths: false,
      deps: [:situ_types]
    )
  end

  # Yaws is an included application, because as a separate application it requires a system-wide configuration.
  # `Situ.Live.Yaws` starts it embedded.
  def application do
    Situ.MixApp.application([:crypto, :public_key, :ssl],
      mod: {Situ.Live.Application, []},
      included_applications: [:yaws]
    )
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
