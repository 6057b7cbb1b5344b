defmodule Situ.CLI.Desktop do
  @moduledoc false
  # Opens pages on the user's desktop, if there is one.

  @read_ms 60_000

  @doc """
  Opens `url` in the desktop's browser. Without a desktop it does nothing, because the address was already printed.
  """
  @spec open_url(String.t()) :: :ok
  def open_url(url) do
    desktop? = System.get_env("DISPLAY") || System.get_env("WAYLAND_DISPLAY")
    opener = desktop? && (System.find_executable("xdg-open") || System.find_executable("open"))
    if opener, do: Task.start(fn -> open_with(opener, url) end)
    :ok
  end

  defp open_with(opener, url) do
    Situ.TempFolder.with_folder("open", fn folder ->
      System.cmd(opener, [opener_argument(url, folder)], stderr_to_stdout: true)

      # The browser has started, but may not have read the page yet.
      receive do
      after
        @read_ms -> :ok
      end
    end)
  end

  @doc """
  Returns the opener's argument for `url`. On a command line, every user of the machine could read a token in the URL.
  For such a URL the argument is therefore a page in `folder` that redirects to it, and that only this user can read.
  """
  @spec opener_argument(String.t(), Path.t()) :: String.t()
  def opener_argument(url, folder) do
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
