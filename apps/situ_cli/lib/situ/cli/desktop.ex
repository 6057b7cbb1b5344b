defmodule Situ.CLI.Desktop do
  @moduledoc false
  # The person's desktop, where there is one.

  @read_ms 60_000

  @doc """
  Opens `url` in the desktop's browser. Where there is no desktop nothing happens: the address has been printed, and
  is all there is.
  """
  @spec open(String.t()) :: :ok
  def open(url) do
    desktop? = System.get_env("DISPLAY") || System.get_env("WAYLAND_DISPLAY")
    opener = desktop? && (System.find_executable("xdg-open") || System.find_executable("open"))
    if opener, do: Task.start(fn -> show(opener, url) end)
    :ok
  end

  defp show(opener, url) do
    Situ.Scratch.with_folder("open", fn folder ->
      System.cmd(opener, [argument(url, folder)], stderr_to_stdout: true)

      # The browser has begun, and may not have read the page yet.
      receive do
      after
        @read_ms -> :ok
      end
    end)
  end

  @doc """
  Returns the opener's argument for `url`. An address with a token goes by a page in `folder` that leads there, which
  only this user can read: on a command line every user of the machine could read it.
  """
  @spec argument(String.t(), Path.t()) :: String.t()
  def argument(url, folder) do
    if URI.parse(url).query == nil do
      url
    else
      page = Path.join(folder, "open.html")
      link = url |> String.replace("&", "&amp;") |> String.replace("\"", "&quot;")
      refresh = ~s(<meta http-equiv="refresh" content="0; url=#{link}">)
      File.write!(page, ~s(<!doctype html>#{refresh}<a href="#{link}">The studio</a>\n))
      page
    end
  end
end
