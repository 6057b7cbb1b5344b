defmodule Situ.CLI.Desktop do
  @moduledoc false
  # The person's desktop, where there is one.

  @doc """
  Opens `url` in the desktop's browser. Where there is no desktop nothing happens: the address has been printed, and
  is all there is.
  """
  @spec open(String.t()) :: :ok
  def open(url) do
    desktop? = System.get_env("DISPLAY") || System.get_env("WAYLAND_DISPLAY")
    opener = desktop? && (System.find_executable("xdg-open") || System.find_executable("open"))
    if opener, do: Task.start(fn -> System.cmd(opener, [url], stderr_to_stdout: true) end)
    :ok
  end
end
