defmodule Situ.Build.Release do
  @moduledoc """
  A step of `mix release` that leaves nothing open to other users of the machine.

      releases: [situ: [steps: [:assemble, &Situ.Build.Release.close/1]]]

  Mix writes the cookie, which lets anybody who knows it run code in the release, into a file that everybody may read,
  and puts it on the command line, which everybody may read too. After this step a release has no cookie of its own:
  a node that is started with `RELEASE_DISTRIBUTION=sname` uses `~/.erlang.cookie` of its user, which Erlang keeps
  readable for that user alone. Without that variable a release listens to nobody (`rel/env.sh.eex`).
  """

  @cookie ~r/ *--cookie "\$RELEASE_COOKIE"( \\\n)?/
  @read ~r/RELEASE_COOKIE=.*\nexport RELEASE_COOKIE\n/

  @doc "Takes the cookie out of the assembled release's script and folder. Raises where Mix's script has another shape."
  @spec close(Mix.Release.t()) :: Mix.Release.t()
  def close(release) do
    script = Path.join([release.path, "bin", to_string(release.name)])
    File.write!(script, without_cookie(File.read!(script)))
    File.rm!(Path.join([release.path, "releases", "COOKIE"]))
    release
  end

  @doc ~S"""
  The text of a release's script, without the cookie.

      iex> exec = "exec elixir --hidden --cookie \"$RELEASE_COOKIE\" \\\n  --boot b\n"
      iex> Situ.Build.Release.without_cookie("RELEASE_COOKIE=x\nexport RELEASE_COOKIE\n" <> exec)
      "exec elixir --hidden  --boot b\n"
  """
  @spec without_cookie(String.t()) :: String.t()
  def without_cookie(script) do
    closed = script |> String.replace(@read, "") |> String.replace(@cookie, "")

    if String.contains?(closed, "COOKIE") or closed == script do
      Mix.raise("""
      the release's script names its cookie in a way this step does not know
        Why: another version of Mix writes another script, and a cookie on the command line is readable by every user
        Fix: look for COOKIE in the script and extend Situ.Build.Release
      """)
    end

    closed
  end
end
