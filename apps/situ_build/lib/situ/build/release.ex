defmodule Situ.Build.Release do
  @moduledoc false
  # Steps of `mix release`: remove the cookie, so that other users of the machine cannot read it,
  # and install the command line.
  #
  #     releases: [situ: [steps: [:assemble, &Situ.Build.Release.remove_cookie/1]]]
  #
  # Anyone who knows the cookie can run code in the release. Mix writes it into a world-readable
  # file and puts it on the command line, which all users can read, too. After this step the
  # release contains no cookie: a node started with `RELEASE_DISTRIBUTION=sname` uses its user's
  # `~/.erlang.cookie`, which only that user can read. Without that variable a release does not
  # listen for other nodes (`rel/env.sh.eex`).

  @cookie ~r/ *--cookie "\$RELEASE_COOKIE"( \\\n)?/
  @read ~r/RELEASE_COOKIE=.*\nexport RELEASE_COOKIE\n/

  @doc "Removes the cookie from the assembled release's script and folder. Raises if Mix's script has an unknown form."
  @spec remove_cookie(Mix.Release.t()) :: Mix.Release.t()
  def remove_cookie(release) do
    script = Path.join([release.path, "bin", to_string(release.name)])
    File.write!(script, without_cookie(File.read!(script)))
    File.rm!(Path.join([release.path, "releases", "COOKIE"]))
    release
  end

  @doc ~S"""
  Returns the text of a release's script without the cookie.

      iex> exec = "exec elixir --hidden --cookie \"$RELEASE_COOKIE\" \\\n  --boot b\n"
      iex> Situ.Build.Release.without_cookie("RELEASE_COOKIE=x\nexport RELEASE_COOKIE\n" <> exec)
      "exec elixir --hidden  --boot b\n"
  """
  @spec without_cookie(String.t()) :: String.t()
  def without_cookie(script) do
    closed = script |> String.replace(@read, "") |> String.replace(@cookie, "")

    if String.contains?(closed, "COOKIE") or closed == script do
      Mix.raise("""
      the release's script uses its cookie in a way that this step does not recognize
        Why: this version of Mix writes a different script, and every user can read a cookie on the command line
        Fix: search for COOKIE in the script and extend Situ.Build.Release
      """)
    end

    closed
  end

  # The script that `mix release` writes controls the virtual machine (start, eval, rpc ...), and has the name of the
  # release. Users expect the command line under this name.
  @scripts ~w(bin/situ bin/demo bin/lib/common.sh bin/lib/dot_iex.exs bin/lib/fetch-model config/installed.exs)

  @doc "Renames Mix's script to `bin/situ-vm`, and installs the command line as `bin/situ`, with its files."
  @spec install_command_line(Mix.Release.t()) :: Mix.Release.t()
  def install_command_line(release) do
    File.rename!(Path.join(release.path, "bin/situ"), Path.join(release.path, "bin/situ-vm"))

    for script <- @scripts do
      target = Path.join(release.path, script)
      File.mkdir_p!(Path.dirname(target))
      File.cp!(script, target)
    end

    release
  end
end
